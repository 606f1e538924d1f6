"""What fixes say of their receiver: jumps, a stuck position, another datum, small deviations."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.residuals import OFF

MOST = 0.5
"""Share of the fixes that may be wrong before odometry is as likely to be."""
FEWEST = 8
"""Fixes that tell how far they scatter."""
SCATTER = 3.0
"""So many times the deviation that they report, they scatter at least where that is wrong."""
LEAST_SCATTER = 0.5
"""Metres; less is odometry's part. Fixes and odometry scatter by 0.36 m from one second to
the next on KITTI, 0.15 m on simulated drives."""
MOST_SCATTER = 10.0
"""Metres; what scatters more is no noise."""
REFUSED = 3
"""Fixes that must have been left out before their deviations are doubted."""
NORMAL, RAYLEIGH = 0.67, 1.18
"""Median size of a normal number, and of a vector of two, in their standard deviations."""
SQRT2 = math.sqrt(2.0)
DRIFTING = 1.5
"""So many times further off over twice the fixes, they drift."""

DRAWN, FAR_DRAWN = 3, 0.5
"""Fixes, and metres by which the worst is off, from which it is told."""
FAR = 5_000.0
"""Metres from a fixed datum at which the vertical there and here differ by 0.8 mrad, which the IMU
notices, and the earth has fallen 2 m below the plane."""
TOO_FAR = 50_000.0
"""Metres at which gravity pulls by 0.08 m/s^2 along the plane, more than biases may be."""
DISTRUST = 100.0
"""So many times the stated deviation, a fix says nothing where the map lies."""
FEWEST_DISTRUSTED, DISTRUSTED = 5, 0.1
"""Fixes, and share of them, that are distrusted at least where a map is told to hang on odometry
alone; those of the start that proved wrong have left it."""


@dataclass(slots=True)
class Suspicion:
    """Fixes that were found wrong for one reason.

    Attributes:
        count: How many.
        first: Stamp of the first one, ns.
        most: Metres by which the worst is off.
    """

    count: int
    first: int
    most: float


@dataclass(frozen=True, slots=True)
class DatumStep:
    """A change of the receiver's datum.

    Attributes:
        stamp: Stamp of the first fix after it, ns.
        shift: East, north and up by which the fixes moved, metres.
        broken: Whether odometry was interrupted there, or has turned, so that it does not say that
            the vehicle stayed where it was.
    """

    stamp: int
    shift: tuple[float, float, float]
    broken: bool = False


@dataclass(slots=True)
class Drawn:
    """Fixes that the map contradicts, though each agrees with the one before.

    Attributes:
        looked_at: Fixes that were held against the map.
        count: Those that were drawn away.
        first: Stamp of the first of them, ns.
        most: Metres by which the worst is off.
        astray: Fixes that are believed less, and off by more than ``OFF``.
        farthest: Metres by which the worst of these is off.
        newest: Metres by which the newest fix is off, if it is believed less.
    """

    looked_at: int = 0
    count: int = 0
    first: int = 0
    most: float = 0.0
    astray: int = 0
    farthest: float = 0.0
    newest: float = 0.0

    def look(self, metres: float) -> None:
        """Count a fix, and the metres by which it is off if it is believed less."""
        self.looked_at += 1
        self.astray += metres > OFF
        self.farthest = max(self.farthest, metres)
        self.newest = metres

    def add(self, stamp: int, metres: float) -> None:
        """Count one that is drawn away by so many metres."""
        self.count += 1
        self.first = self.first or stamp
        self.most = max(self.most, metres)


CUT = 'the recording may be cut there, or scan matching has lost its way'
_TEXTS = {
    'gnss_jump': 'are up to {most} from where odometry and the fixes before them say',
    'frozen_fix': 'repeat a position bit for bit while the car moves up to {most}',
    'datum_outlier': 'at the start are up to {most} from where the later ones and odometry say',
    'altitude_jump': 'are up to {most} higher or lower than odometry and the fixes before them say',
}
_ABANDONED = 'at the start agree neither with later ones nor with odometry'
"""Of fixes that nothing was left to measure their distance from."""
_REMEDIES = {
    'altitude_jump': 'their heights are moved back where that is certain, else left out',
}


def judged_fixes(
    sensor: str, received: int, suspicions: Mapping[str, Suspicion], steps: list[DatumStep]
) -> tuple[Finding, ...]:
    """What was found wrong with the fixes of a drive.

    Args:
        sensor: Name of the receiver.
        received: Its usable fixes.
        suspicions: Those that were found wrong, by reason.
        steps: Changes of its datum.
    """
    out = sum(one.count for reason, one in suspicions.items() if reason != 'altitude_jump')
    found = [
        Finding(
            rule=reason,
            severity=_severity(reason, out, received),
            sensor=sensor,
            text=f'{one.count} of {received} fixes {_text(reason, one)}, the first at {one.first}',
            remedy=_REMEDIES.get(reason, _left_out(out, received)),
        )
        for reason, one in suspicions.items()
    ]
    if steps:
        east, north, up = steps[-1].shift
        broken = f', which is interrupted there: {CUT}' if any(s.broken for s in steps) else ''
        found.append(
            Finding(
                rule='datum_step',
                severity=Severity.ERROR if broken else Severity.WARNING,
                sensor=sensor,
                text=f'the datum changes {len(steps)} times, last at {steps[-1].stamp} by '
                f'{_metres(float(np.hypot(east, north)))} horizontally and {_metres(abs(up))} '
                f'vertically, while fixes before and after agree with odometry{broken}',
                remedy='fixes after it are moved back; the datum of the larger part is kept',
            )
        )
    return tuple(found)


def _text(reason: str, one: Suspicion) -> str:
    if reason == 'datum_outlier' and one.most == 0.0:
        return _ABANDONED
    return _TEXTS[reason].format(most=_metres(one.most))


def fixes_elsewhere(sensor: str, count: int, first: int, metres: float) -> Finding:
    """Fixes that agree with each other and with odometry, and that a map does not follow.

    Args:
        sensor: Name of the receiver.
        count: How many there are, the newest among them.
        first: Stamp of the first of them, ns.
        metres: How far the newest is from where the map has it.
    """
    return Finding(
        'fixes_elsewhere',
        Severity.ERROR,
        sensor,
        f'the last {count} fixes, from {first} on, agree with each other and with odometry, and '
        f'are {_metres(metres)} from where those before them say, or turned: {CUT}',
        'map what is before it and what is behind it alone',
    )


def drawn_away(sensor: str, drawn: Drawn, ended: bool = False) -> tuple[Finding, ...]:
    """Fixes that are drawn away from the map little by little.

    Args:
        sensor: Name of the receiver.
        drawn: All of a drive so far.
        ended: Whether no more fixes come.

    Returns:
        ``gnss_drift``, an error where most fixes are metres off, or the last ones, which never came
        back: then nobody knows where the map is; nothing where they are few and near.
    """
    lost = drawn.astray > max(MOST * drawn.looked_at, DRAWN)
    away = ended and drawn.count >= DRAWN and drawn.newest > OFF
    if not lost and (drawn.count < DRAWN or drawn.most < FAR_DRAWN):
        return ()
    severity = Severity.WARNING if drawn.count > MOST * drawn.looked_at else Severity.MENDED
    if lost or away:
        severity = Severity.ERROR
    count = max(drawn.count, drawn.astray if lost else 0)
    since = f', the first at {drawn.first}' if drawn.first else ''
    until = f', and the last of all is still {_metres(drawn.newest)} off' if away else ''
    return (
        Finding(
            'gnss_drift',
            severity,
            sensor,
            f'{count} of {drawn.looked_at} fixes are drawn up to '
            f'{_metres(max(drawn.most, drawn.farthest if lost else 0.0))} away '
            f'from where those before them, matches and IMU put them{since}{until}: '
            'reflections between houses, or a reference that wanders',
            'they are believed less; if the receiver is right, scan matching is wrong there',
        ),
    )


def far_datum(sensor: str, farthest: float, first: int) -> tuple[Finding, ...]:
    """A fixed datum that is far from the fixes.

    Args:
        sensor: Name of the receiver.
        farthest: Largest distance of a fix from the datum, metres.
        first: Stamp of the first fix that was left out because it was too far, ns; 0 where none.
    """
    if farthest <= FAR:
        return ()
    left_out = f', beyond {_metres(TOO_FAR)} they are left out, the first at {first}'
    return (
        Finding(
            rule='far_datum',
            severity=Severity.ERROR if first else Severity.WARNING,
            sensor=sensor,
            text=f'fixes are up to {farthest / 1000.0:.0f} km from the datum of the settings, but '
            f'the map is flat and the earth is not{left_out if first else ""}',
            remedy=f'give datum.latitude and datum.longitude within {_metres(FAR)} of the drive',
        ),
    )


def scatter(enu: NDArray[np.float64], local: NDArray[np.float64], yaw: float | None) -> float:
    """Standard deviation of fixes that scatter at random around odometry, metres.

    Args:
        enu: Fixes (K, 3), metres, K from ``FEWEST`` on.
        local: The same by odometry.
        yaw: From odometry's frame to ENU, radians, None where it is not known.

    Returns:
        The smallest of what lengths and directions say; 0 where the fixes drift away instead:
        over twice as many fixes they are then twice as far off, noise is not.
    """
    near, far = _off(enu, local, yaw), _off(enu[::2], local[::2], yaw)
    return 0.0 if far > DRIFTING * near else near


def _off(enu: NDArray[np.float64], local: NDArray[np.float64], yaw: float | None) -> float:
    """Standard deviation of each of two fixes by the median difference from one to the next."""
    a, b = np.diff(enu[:, :2], axis=0), np.diff(local[:, :2], axis=0)
    # Lengths are one number of two, where there is a length; two where the car stands.
    length = float(np.median(np.abs(np.hypot(*a.T) - np.hypot(*b.T)))) / NORMAL
    if yaw is None:
        return length / SQRT2
    cosine, sine = np.cos(yaw), np.sin(yaw)
    apart = np.hypot(*(a - b @ np.array([[cosine, sine], [-sine, cosine]])).T)
    return min(length, float(np.median(apart)) / RAYLEIGH) / SQRT2


def too_certain(sensor: str, fixes: int, reported: float, seen: float) -> Finding | None:
    """Deviations that are far smaller than the fixes scatter.

    Args:
        sensor: Name of the receiver.
        fixes: How many were looked at.
        reported: Their median standard deviation, with the settings' floor, metres.
        seen: How far they scatter, metres.
    """
    if fixes < FEWEST or not max(SCATTER * reported, LEAST_SCATTER) < seen < MOST_SCATTER:
        return None
    sigma = float(np.ceil(10.0 * seen) / 10.0)
    return Finding(
        rule='optimistic_covariance',
        severity=Severity.MENDED,
        sensor=sensor,
        text=f'{fixes} fixes scatter by {seen:.1f} m against odometry, where their covariances '
        f'say {reported:.2f} m',
        remedy=f'fixes.min_sigma: {sigma} is used',
        settings={'fixes': {'min_sigma': sigma}},
    )


def _severity(reason: str, out: int, received: int) -> Severity:
    if reason == 'frozen_fix' or out > MOST * received:
        return Severity.WARNING
    return Severity.MENDED


def _left_out(out: int, received: int) -> str:
    if out > MOST * received:
        return 'they are left out; if the receiver is right, scan matching is wrong'
    return 'they are left out'


def _metres(value: float) -> str:
    return f'{value / 1000.0:.0f} km' if value >= 10_000.0 else f'{value:.1f} m'


def hardly_trusted(
    sensor: str,
    stated: NDArray[np.float64],
    given: NDArray[np.float64],
    off: NDArray[np.float64],
    stamps: NDArray[np.int64],
) -> tuple[Finding, ...]:
    """Fixes that a finished map has, but hardly trusts, since odometry contradicts them.

    Args:
        sensor: Name of the receiver.
        stated: Horizontal variances of the fixes (F,), m^2.
        given: Those that their factors have (F,).
        off: Horizontal distances (F,) of the fixes from where the map has the antenna, metres.
        stamps: Stamps (F,), ns.

    Returns:
        ``fixes_distrusted`` where these are many, an error where they are most of all and metres
        off: either the map is wrong then or its receiver is. Nothing else.
    """
    doubted = np.flatnonzero(given > DISTRUST**2 * stated)
    if len(doubted) < max(FEWEST_DISTRUSTED, DISTRUSTED * len(stated)):
        return ()
    metres = float(np.median(off[doubted]))
    astray = len(doubted) > MOST * len(stated) and metres > OFF
    return (
        Finding(
            'fixes_distrusted',
            Severity.ERROR if astray else Severity.WARNING,
            sensor,
            f'{len(doubted)} of {len(stated)} fixes in the map are given next to no weight, the '
            f'first at {stamps[doubted[0]]}: they are {_metres(metres)} from it, contradict '
            'odometry, and nothing tells which of the two is right',
            'hold the map against the fixes: if the receiver is right, scan matching is wrong',
        ),
    )
