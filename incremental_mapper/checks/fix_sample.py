"""What fixes show by themselves, before there is odometry to hold them against."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.measurements import NANOSECONDS

FASTEST = 100.0
"""m/s between two fixes that no car drives; the drives here have at most 14."""
NEAR = 50.0
"""Metres by which fixes may be off on top of that: multipath and the lever arm are within it."""
USABLE = 0.5
"""Share of the fixes below which it is told why the others are not; all sound drives have 1.0."""
_EARTH = 6_371_000.0


def far_fixes(sensor: str, stamps: NDArray[np.int64], places: NDArray[np.float64]) -> list[Finding]:
    """Find fixes that cannot be reached from the middle one of all.

    Args:
        sensor: name of the receiver.
        stamps: of the fixes (N,), ns.
        places: latitude and longitude (N, 2), degrees.

    Returns:
        A warning with how many there are, if there are any.
    """
    if len(stamps) < 3:
        return []
    radians = np.radians(places)
    middle = np.median(radians, axis=0)
    north = radians[:, 0] - middle[0]
    east = (radians[:, 1] - middle[1]) * np.cos(middle[0])
    metres = _EARTH * np.hypot(north, east)
    reach = NEAR + FASTEST * float(np.ptp(stamps)) / NANOSECONDS
    far = np.flatnonzero(metres > reach)
    if not len(far):
        return []
    worst = far[np.argmax(metres[far])]
    text = (
        f'{len(far)} of {len(stamps)} fixes that were looked at lie up to '
        f'{metres[worst] / 1000.0:.1f} km from the others, which no car drives in the time; '
        f'one has the stamp {stamps[worst]}'
    )
    remedy = 'they are left out while mapping, where odometry shows that they are wrong'
    return [Finding('far_fix', Severity.WARNING, sensor, text, remedy)]


def unusable_fixes(
    sensor: str, looked: int, reasons: Mapping[str, int], largest: float
) -> list[Finding]:
    """Tell why most fixes are not used.

    Args:
        sensor: name of the receiver.
        looked: how many fixes were looked at.
        reasons: how many of them are not used, by reason.
        largest: median standard deviation of those that are too uncertain, metres.

    Returns:
        A warning with the setting that would use them, where there is one.
    """
    out = sum(reasons.values())
    if not looked or out <= (1.0 - USABLE) * looked:
        return []
    remedies = {
        'low_status': 'fixes.min_status: 0 uses them as well',
        'too_uncertain': f'fixes.max_sigma: {np.ceil(2.0 * largest):.0f} uses them as well',
    }
    main = max(reasons, key=lambda reason: reasons[reason])
    said = ', '.join(f'{reason} {count}x' for reason, count in reasons.items())
    return [
        Finding(
            'few_usable_fixes',
            Severity.WARNING,
            sensor,
            f'{out} of {looked} fixes that were looked at are not used: {said}',
            remedies.get(main, 'see the reason on the page of messages'),
        )
    ]
