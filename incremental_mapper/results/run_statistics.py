"""``stats.json`` as one record: what the mapper counted, and what the run around it adds."""

import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib import metadata
from typing import Any, Self, TypeAlias

import numpy as np

from incremental_mapper import __version__
from incremental_mapper.candidates.model import CoreKind
from incremental_mapper.checks.finding import Finding, ranked
from incremental_mapper.checks.outcome import empty_findings
from incremental_mapper.checks.sensors import SensorUse, sensor_findings
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.result import MapResult, Session
from incremental_mapper.mapping.statistics import MapStatistics, peak_rss_mb
from incremental_mapper.measurements import Drops
from incremental_mapper.results.trajectory_errors import TrajectoryErrors

DropCounts: TypeAlias = dict[str, dict[str, int]]
"""Numbers of measurements that were not used, by sensor and reason."""

LIBRARIES = ('gtsam', 'kiss-icp', 'small_gicp', 'rosbags', 'numpy', 'scipy', 'pymap3d')


FOLLOWING = ('sensor_silent', 'sensor_unused')
"""Rules that say no more than any other finding of the sensor."""


@dataclass(frozen=True, slots=True)
class InputFacts:
    """What was mapped: where it came from, its kind, its measurements by sensor, remarks."""

    path: str
    kind: str
    counts: Mapping[str, int]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class WindowSeconds:
    """Seconds that windows took: median, 99th percentile, means of the first and last tenth."""

    window_median_s: float
    window_p99_s: float
    window_first_tenth_s: float
    window_last_tenth_s: float


@dataclass(frozen=True, slots=True)
class RunStatistics:
    """Everything that ``stats.json`` tells of a run.

    ``mapped`` holds the mapper's own keys. ``dropped`` counts what was lost in the mapper and
    before it. ``wall_s`` are the seconds that the run took and ``real_time_factor`` those of the
    drive divided by them; ``peak_rss_mb`` is the largest resident memory of the process.
    ``warnings`` are what was found wrong, the worst first.
    ``sessions`` are those that the map was made in, none where it is one.
    ``windows`` is None where no window held a core measurement, ``errors`` where there is no
    truth.
    """

    mapped: MapStatistics
    dropped: DropCounts
    wall_s: float
    real_time_factor: float
    peak_rss_mb: float
    windows: WindowSeconds | None
    versions: Mapping[str, str]
    interrupted: bool
    map_points: int
    errors: TrajectoryErrors | None
    input: InputFacts
    warnings: tuple[Finding, ...] = ()
    sessions: tuple[Session, ...] = ()

    @classmethod
    def of_run(
        cls,
        result: MapResult,
        drops: Drops,
        wall_s: float,
        map_points: int,
        facts: InputFacts,
        errors: TrajectoryErrors | None = None,
        interrupted: bool = False,
        findings: Iterable[Finding] = (),
    ) -> Self:
        """The record of a run that has just ended in this process.

        Args:
            result: What the mapper made.
            drops: Measurements that were lost before they reached the mapper.
            wall_s: Seconds from the first measurement to the map.
            map_points: Number of points of the saved map.
            facts: What was mapped.
            errors: Against the truth, where there is one.
            interrupted: Whether the rest of the input was not read.
            findings: What was wrong with the input, before the mapper's own.
        """
        dropped = _all_drops(result.statistics.dropped, drops)
        known = [*findings, *result.findings]
        seconds = result.statistics.drive_s
        # Whoever knows why a sensor is not used has said so.
        explained = {finding.sensor for finding in known}
        lost = [
            item
            for item in sensor_findings(sensor_uses(result, dropped, drops), seconds)
            if item.rule not in FOLLOWING or item.sensor not in explained
        ]
        empty = empty_findings(map_points, len(result.scans), seconds)
        return cls(
            mapped=result.statistics,
            dropped=dropped,
            wall_s=wall_s,
            real_time_factor=result.statistics.drive_s / wall_s,
            peak_rss_mb=peak_rss_mb(),
            windows=_window_seconds(result),
            versions=versions(),
            interrupted=interrupted,
            map_points=map_points,
            errors=errors,
            input=facts,
            warnings=ranked([*lost, *empty, *known]),
            sessions=result.sessions,
        )

    def to_tree(self) -> dict[str, Any]:
        """The keys of ``stats.json`` in their order, as plain values."""
        return {
            'warnings': [finding.to_tree() for finding in self.warnings],
            **self.mapped.to_tree(),
            'dropped': self.dropped,
            'wall_s': self.wall_s,
            'real_time_factor': self.real_time_factor,
            'peak_rss_mb': self.peak_rss_mb,
            **({} if self.windows is None else asdict(self.windows)),
            'versions': dict(self.versions),
            'interrupted': self.interrupted,
            'map_points': self.map_points,
            **({} if self.errors is None else asdict(self.errors)),
            'input': {
                'path': self.input.path,
                'kind': self.input.kind,
                'counts': dict(self.input.counts),
                'notes': list(self.input.notes),
            },
            **({'sessions': [asdict(one) for one in self.sessions]} if self.sessions else {}),
        }


def versions() -> dict[str, str]:
    """Versions of this package, of Python, and of the libraries that numbers depend on."""
    own = {'incremental_mapper': __version__, 'python': sys.version.split()[0]}
    return own | {name: metadata.version(name) for name in LIBRARIES}


def sensor_uses(result: MapResult, dropped: DropCounts, before: Drops) -> list[SensorUse]:
    """What became of the messages of every sensor that the settings name or that sent any.

    Args:
        result: What the mapper made.
        dropped: Everything that was left out.
        before: What of it never reached the mapper.
    """
    statistics = result.statistics
    settings = statistics.settings or {}
    scans = Counter(scan.sensor for scan in result.scans)
    # While the vehicle stands they say what those before said: they are used, and add no points.
    joined = (core for placed in result.clusters for core in placed.joined)
    scans.update(core.sensor for core in joined if core.kind is CoreKind.LIDAR)
    offered = Counter(statistics.received or {})
    for (sensor, _), count in before.items():
        offered[sensor] += count
    spans, fixes = (
        (statistics.factors_by_kind or {}).get(str(kind), 0)
        for kind in (FactorKind.IMU, FactorKind.GNSS)
    )
    uses = [
        SensorUse(name, 'lidar', offered[name], scans[name], dropped.get(name, {}))
        for name in dict.fromkeys([*settings.get('lidars', {}).get('names', ()), *scans])
    ]
    for name, used in (('imu', spans), ('gnss', fixes)):
        named = bool(settings.get(name, {}).get('topic'))
        uses.append(SensorUse(name, name, offered[name], used, dropped.get(name, {}), named))
    return uses


def _all_drops(in_mapper: Mapping[str, Mapping[str, int]], before: Drops) -> DropCounts:
    dropped = {sensor: dict(reasons) for sensor, reasons in in_mapper.items()}
    for (sensor, reason), count in before.items():
        reasons = dropped.setdefault(sensor, {})
        reasons[reason] = reasons.get(reason, 0) + count
    return dropped


def _window_seconds(result: MapResult) -> WindowSeconds | None:
    seconds = np.array([row['window_s'] for row in result.rows if row['core']])
    if len(seconds) == 0:
        return None
    tenth = max(len(seconds) // 10, 1)
    return WindowSeconds(
        window_median_s=float(np.median(seconds)),
        window_p99_s=float(np.percentile(seconds, 99)),
        window_first_tenth_s=float(seconds[:tenth].mean()),
        window_last_tenth_s=float(seconds[-tenth:].mean()),
    )
