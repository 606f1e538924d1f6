"""What became of a map as a whole: what holds it together, and what of it is missing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from incremental_mapper.checks.finding import Finding, Severity

SOME, MOST = 0.1, 0.5
"""Shares from which a user is told of a loss, and from which what is left is not a map of the
drive. Sound runs have no bridge and no failed window at all."""
FEW_WINDOWS = 10
"""Windows with measurements that make a judgement."""
FEW_FIXES = 5
"""Fixes that would turn the map to north if they agreed with its motion."""
FAR = 20.0
"""Metres that a vehicle has left its start behind before it must be known where north is: ten times
``fixes.min_distance``."""
FEW_POINTS = 1000
"""Points of a map that show nothing. One VLP-16 in a street leaves ten thousand in a second."""
FEW_SCANS = 10
"""Scans that make a judgement."""
FEW_HELD = 5
"""Windows from which it may be said that nothing but the IMU holds a map."""
LONG = 1.0
"""Seconds of a drive from which its map may be judged."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Numbers of a map.

    Attributes:
        clusters: Poses.
        bridges: Factors that stand for missing measurements.
        windows: Windows that held measurements.
        failed: Those that raised.
        carried: Those whose measurements nothing connected to the map.
        scans: Scans of the map, by LiDAR.
        matched: Those of them that are matched to an earlier scan, by LiDAR.
        reasons: Why scans are not matched, with counts, by LiDAR, in words.
        fixes: Fixes of the map.
        georeferenced: Whether the map is ENU.
        farthest: Metres between the first pose and the farthest one that was looked at.
        records: Files with the inputs of failed windows.
    """

    clusters: int
    bridges: int
    windows: int
    failed: int
    carried: int
    scans: Mapping[str, int] = field(default_factory=dict)
    matched: Mapping[str, int] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    fixes: int = 0
    georeferenced: bool = True
    farthest: float = 0.0
    records: tuple[str, ...] = ()


def outcome_findings(outcome: Outcome) -> list[Finding]:
    """Say what a map as a whole lacks.

    Args:
        outcome: Its numbers.

    Returns:
        The findings, in no order.
    """
    rules = (_bridges, _failed, _carried, _not_georeferenced, _held_by_imu)
    found = [finding for rule in rules if (finding := rule(outcome)) is not None]
    return [*found, *_unmatched(outcome)]


def bridged_share(bridges: int, clusters: int) -> float:
    """Share of a graph's poses that hang on a bridge."""
    return bridges / max(clusters - 1, 1)


def _severity(share: float) -> Severity:
    return Severity.ERROR if share > MOST else Severity.WARNING


def _bridges(outcome: Outcome) -> Finding | None:
    share = bridged_share(outcome.bridges, outcome.clusters)
    if share <= SOME or outcome.bridges < 2:
        return None
    return Finding(
        'held_by_bridges',
        _severity(share),
        '',
        f'{outcome.bridges} of {outcome.clusters} poses hang on the map by a bridge, a guess in '
        'place of measurements: no match, no IMU span and no fix connects them',
        'see what was not used and why; mostly clocks that differ, extrinsics, or scans that '
        'cannot be matched',
    )


def _failed(outcome: Outcome) -> Finding | None:
    if not outcome.failed:
        return None
    share = outcome.failed / max(outcome.windows, 1)
    files = f'; their inputs are in {", ".join(outcome.records)}' if outcome.records else ''
    return Finding(
        'windows_failed',
        _severity(share),
        '',
        f'{outcome.failed} of {outcome.windows} windows failed and are left out with their '
        f'measurements{files}',
        'a fault of the program: report it with the log and these files'
        if outcome.records
        else 'a fault of the program: report it with the log',
    )


def _carried(outcome: Outcome) -> Finding | None:
    share = outcome.carried / max(outcome.windows, 1)
    if outcome.windows < FEW_WINDOWS or share <= SOME * 2.0:
        return None
    return Finding(
        'windows_carried',
        Severity.WARNING,
        '',
        f'in {outcome.carried} of {outcome.windows} windows nothing connected the measurements to '
        'the map, and they waited for the next ones',
        'look for scans without a match, holes in the IMU, and clocks that differ',
    )


def _not_georeferenced(outcome: Outcome) -> Finding | None:
    if outcome.georeferenced or outcome.fixes < FEW_FIXES or outcome.farthest < FAR:
        return None
    return Finding(
        'not_georeferenced',
        Severity.WARNING,
        'gnss',
        f'{outcome.fixes} fixes do not agree with the motion of the vehicle, which went '
        f'{outcome.farthest:.0f} m away: the map is not turned to north',
        'check gnss.time_offset, the first fixes, fixes.min_status, and T_base_sensor of the '
        'LiDARs',
    )


def _held_by_imu(outcome: Outcome) -> Finding | None:
    """Matches and fixes are what a map hangs on: an IMU alone does not even know its speed."""
    if outcome.windows < FEW_HELD or (outcome.georeferenced and outcome.fixes):
        return None
    if bridged_share(outcome.bridges, outcome.clusters) > MOST:
        return None  # not even an IMU holds it, which is said
    linkable = sum(max(scans - 1, 0) for scans in outcome.scans.values())
    matched = sum(outcome.matched.values())
    if not linkable or matched >= (1.0 - MOST) * linkable:
        return None
    why = '; '.join(f'{sensor}: {text}' for sensor, text in sorted(outcome.reasons.items()) if text)
    return Finding(
        'held_by_imu_alone',
        Severity.ERROR,
        '',
        f'{matched} of {linkable} scans are matched to one before them and no fix is in the map: '
        'most of it hangs on the IMU alone, whose speed at the start is a guess'
        + (f' ({why})' if why else ''),
        'record whole sweeps that overlap, a scan for each few metres of way, or fixes; see '
        'odometry.max_gap for slow recordings',
    )


def empty_findings(points: int, scans: int, seconds: float) -> list[Finding]:
    """Say where a map has next to no points.

    Args:
        points: Points of the map.
        scans: Scans that are in it; without any it is ``no_scan_used`` that says so.
        seconds: Of the drive.
    """
    if scans == 0 or points >= FEW_POINTS or seconds < LONG:
        return []
    return [
        Finding(
            'map_empty',
            Severity.ERROR if points < FEW_POINTS / 10 else Severity.WARNING,
            '',
            f'the map has {points} points of {scans} scans',
            'check odometry.min_range, odometry.max_range and map.max_range, and the unit of the '
            'points',
        )
    ]


def _unmatched(outcome: Outcome) -> list[Finding]:
    found = []
    for sensor, scans in sorted(outcome.scans.items()):
        share = 1.0 - outcome.matched.get(sensor, 0) / max(scans - 1, 1)
        if scans < FEW_SCANS or share <= MOST:
            continue
        reasons = outcome.reasons.get(sensor, '')
        found.append(
            Finding(
                'scans_unmatched',
                Severity.WARNING,
                sensor,
                f'{share:.0%} of its {scans} scans are matched to no scan before them'
                + (f' ({reasons})' if reasons else ''),
                f'check whether lidars.{sensor} is one LiDAR with whole sweeps, its points and '
                'their times, and odometry.max_gap for slow recordings',
            )
        )
    return found


def unreadable_findings(reasons: Sequence[str]) -> list[Finding]:
    """Say that points of a map are missing because they cannot be read back.

    Args:
        reasons: Why, for each scan.
    """
    if not reasons:
        return []
    text = f'the points of {len(reasons)} scans are left out: {reasons[0]}'
    remedy = 'look at the disk of map.store_folder, or of the journal'
    return [Finding('scans_unreadable', Severity.ERROR, '', text, remedy)]
