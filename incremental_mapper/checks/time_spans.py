"""Clocks by the spans of the sensors alone: where nobody recorded when the messages came."""

from collections.abc import Sequence

from incremental_mapper.checks.finding import Finding, Severity, listed
from incremental_mapper.checks.sensor_clocks import SensorClock, setting_line
from incremental_mapper.checks.time_scales import known_offset
from incremental_mapper.measurements import NANOSECONDS

ENDS = 1.5
"""Seconds by which sensors of one recording begin, and end, apart: a receiver of 1 Hz, a LiDAR that
is stopped before the IMU. KAIST folders have up to 0.3 with receivers of 1 Hz up to 1."""
SMALLEST_SHIFT = 15.0
"""Seconds; no two time scales are nearer."""


def span_findings(clocks: Sequence[SensorClock]) -> tuple[Finding, ...]:
    """Find sensors on another clock than the rest, by their first and last stamps.

    Args:
        clocks: stamps of every sensor, at least the first and the last.

    Returns:
        ``clock_offset`` where a sensor begins and ends as much later or earlier than the others as
        two time scales differ: mended; ``no_common_time`` where sensors share no time.
    """
    if len(clocks) < 2:
        return ()
    groups = _alike(clocks)
    reference = max(groups, key=_rank)
    found: list[Finding] = []
    shifted: list[SensorClock] = []
    for group in groups:
        if group is reference:
            continue
        offset = _known(group, reference)
        if offset is not None:
            found += _offset(group, reference, *offset)
            shifted += group
    rest = [clock for clock in clocks if not any(clock is other for other in shifted)]
    return (*found, *apart_findings(rest))


def _alike(clocks: Sequence[SensorClock]) -> list[list[SensorClock]]:
    """Sensors that begin and end together."""
    groups: list[list[SensorClock]] = []
    for clock in sorted(clocks, key=lambda clock: clock.first):
        for group in groups:
            ends = abs(clock.first - group[0].first), abs(clock.last - group[0].last)
            if max(ends) <= ENDS * NANOSECONDS:
                group.append(clock)
                break
        else:
            groups.append([clock])
    return groups


def _rank(group: Sequence[SensorClock]) -> tuple[int, bool, int]:
    """Most sensors; then those with the receiver; then the clock that is behind: UTC."""
    return len(group), any(clock.sensor == 'gnss' for clock in group), -group[0].first


def _known(
    group: Sequence[SensorClock], reference: Sequence[SensorClock]
) -> tuple[int, str] | None:
    """Seconds by which a group is ahead, and the name of its time scale, if it is one."""
    ends = [
        (choose(getattr(c, end) for c in group) - choose(getattr(c, end) for c in reference))
        / NANOSECONDS
        for end, choose in (('first', min), ('last', max))
    ]
    if min(abs(end) for end in ends) < SMALLEST_SHIFT or abs(ends[0] - ends[1]) > ENDS:
        return None
    utc = max(clock.last for clock in reference)
    return known_offset(sum(ends) / 2.0, utc, ENDS / 2.0, within=True)


def _offset(
    group: Sequence[SensorClock], reference: Sequence[SensorClock], whole: int, name: str
) -> list[Finding]:
    found = []
    for clock in group:
        line, tree = setting_line(clock, -whole * NANOSECONDS)
        found.append(
            Finding(
                'clock_offset',
                Severity.WARNING if clock.chosen else Severity.MENDED,
                clock.sensor,
                f'stamps begin and end {abs(whole)} s {"after" if whole > 0 else "before"} those '
                f'of {listed([other.sensor for other in reference])}: {name}',
                f'set {line}' if clock.chosen else f'mended as with {line}',
                tree,
            )
        )
    return found


def apart_findings(clocks: Sequence[SensorClock]) -> list[Finding]:
    """Find sensors that share no time with the LiDARs.

    Args:
        clocks: stamps of every sensor, at least the first and the last.

    Returns:
        ``no_common_time``, an error where it is so of all other sensors.
    """
    lidars = [clock for clock in clocks if clock.is_lidar]
    others = [clock for clock in clocks if not clock.is_lidar]
    if not lidars:
        return []
    first, last = min(c.first for c in lidars), max(c.last for c in lidars)
    lonely = [c for c in others if c.first > last or c.last < first]
    names = listed([clock.sensor for clock in lidars])
    found = []
    for clock in lonely:
        line, tree = setting_line(clock, first - clock.first)
        found.append(
            Finding(
                'no_common_time',
                Severity.ERROR if len(lonely) == len(others) else Severity.WARNING,
                clock.sensor,
                f'no stamp lies within those of {names}: '
                f'{_span(clock.first, clock.last)} against {_span(first, last)}',
                f'if its clock is another one, set {line} (it lays first stamp on first stamp, '
                'right to about a second) and find the exact number',
                tree,
            )
        )
    return found


def _span(first: int, last: int) -> str:
    return f'{first / NANOSECONDS:.1f} to {last / NANOSECONDS:.1f} s'
