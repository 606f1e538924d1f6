"""Sensors of which nothing, or next to nothing, came into the map."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from incremental_mapper.checks.finding import Finding, Severity

MOSTLY = 0.5
"""Share of a LiDAR's scans that is left out from which a user is told first of all. Sound runs
leave out none; a receiver's fixes are often below the wanted status, and are told from all on."""
FEW = 5
"""Messages that make a judgement."""
LONG = 3.0
"""Seconds of a recording after which every sensor has sent something."""
LATE_REASON, LATE = 'late', 0.1
"""Reason of measurements that come after their window was closed, and their share from which a user
is told. Sound recordings have none; where a simulator begins anew in one, all that follows is."""
SWITCHED_OFF = 'switched_off'
"""Reason of samples that the settings do not want."""
REASONS = 3
"""Reasons that are told, the most frequent ones."""
NONE_REFUSED = 'none was refused: their windows were not mapped'


@dataclass(frozen=True, slots=True)
class SensorUse:
    """What became of one sensor's messages.

    Attributes:
        name: Of the sensor.
        kind: ``lidar``, ``imu`` or ``gnss``.
        offered: Messages that the input holds or that came in.
        used: Those that are in the map: scans, fixes, or samples in its spans.
        dropped: Counts of those that were left out, by reason.
        configured: Whether the settings name it.
    """

    name: str
    kind: str
    offered: int
    used: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    configured: bool = True


def sensor_findings(sensors: Sequence[SensorUse], seconds: float) -> list[Finding]:
    """Say which sensors are lost.

    Args:
        sensors: What became of every sensor that is configured or sent.
        seconds: Of the recording; in a short one a receiver of 1 Hz may well have sent nothing.

    Returns:
        ``no_scan_used`` (an error), ``sensor_silent``, ``sensor_unused``,
        ``sensor_mostly_unused`` and ``came_late``.
    """
    lidars = [item for item in sensors if item.kind == 'lidar']
    heard = [item for item in sensors if item.offered or seconds > LONG]
    others = [item for item in heard if item.kind != 'lidar']
    found = []
    if sum(item.used for item in lidars) == 0:
        found.append(_no_scan(lidars))
    else:
        found += [
            finding
            for item in heard
            if item.kind == 'lidar' and (finding := _lidar(item)) is not None
        ]
    found += [finding for item in others if (finding := _other(item)) is not None]
    told = {finding.sensor for finding in found}
    return [*found, *(late for item in heard if item.name not in told for late in _late(item))]


def _no_scan(lidars: Iterable[SensorUse]) -> Finding:
    named = [item for item in lidars if item.offered]
    told = '; '.join(f'{item.name}: {_counts(item) or NONE_REFUSED}' for item in named)
    return Finding(
        'no_scan_used',
        Severity.ERROR,
        '',
        'no scan of any LiDAR could be used, so that there is no map'
        + (f' ({told})' if told else ''),
        'look up the reasons on the page of messages; mostly clocks, ranges, or the wrong topic',
    )


def _lidar(item: SensorUse) -> Finding | None:
    if item.offered == 0:
        return _silent(item) if item.configured else None
    lost = item.offered - item.used
    if item.offered < FEW or lost <= MOSTLY * item.offered:
        return None
    rule = 'sensor_unused' if item.used == 0 else 'sensor_mostly_unused'
    return Finding(
        rule,
        Severity.WARNING,
        item.name,
        f'{lost} of {item.offered} scans are not in the map ({_counts(item) or NONE_REFUSED})',
        'look up the reasons on the page of messages',
    )


def _other(item: SensorUse) -> Finding | None:
    if item.offered == 0:
        return _silent(item) if item.configured else None
    if item.offered < FEW or item.dropped.get(SWITCHED_OFF):
        return None
    imu = item.kind == 'imu'
    lost = sum(item.dropped.values())
    if item.used and imu and lost > MOSTLY * item.offered:
        return Finding(
            'sensor_mostly_unused',
            Severity.WARNING,
            item.name,
            f'{lost} of {item.offered} samples were left out ({_counts(item)})',
            'look up the reasons on the page of messages; duplicate_stamp: the driver must not '
            'round its stamps',
        )
    if item.used:
        return None
    what = (
        'samples came in, and none is in a span of the map'
        if imu
        else 'fixes came in, and none is in the map'
    )
    reasons = _counts(item)
    return Finding(
        'sensor_unused',
        Severity.WARNING,
        item.name,
        f'{item.offered} {what}' + (f' ({reasons})' if reasons else ''),
        f'check {item.name}.time_offset (its clock against the LiDARs) and preintegration.max_gap '
        '(holes between samples)'
        if imu
        else f'check {item.name}.time_offset, fixes.min_status and fixes.max_sigma',
    )


def _late(item: SensorUse) -> list[Finding]:
    late = item.dropped.get(LATE_REASON, 0)
    if item.offered < FEW or late <= LATE * item.offered:
        return []
    return [
        Finding(
            'came_late',
            Severity.WARNING,
            item.name,
            f'{late} of {item.offered} messages were left out, for they came when what is stamped '
            'later was mapped already',
            'where all stamps step back, as of a simulator that begins anew, map the parts by '
            'themselves; where one sensor comes late, set window.lateness to more than its delay',
        )
    ]


def _silent(item: SensorUse) -> Finding:
    section = f'lidars.{item.name}' if item.kind == 'lidar' else item.name
    return Finding(
        'sensor_silent',
        Severity.WARNING,
        item.name,
        'the settings name it, and it sent nothing',
        f'check {section}.topic, or leave the section out',
    )


def _counts(item: SensorUse) -> str:
    worst = sorted(item.dropped.items(), key=lambda pair: (-pair[1], pair[0]))[:REASONS]
    return ', '.join(f'{count} {reason}' for reason, count in worst)
