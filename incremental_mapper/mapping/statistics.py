"""Numbers of a window and of a run, under the keys that the files use."""

import resource
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields
from typing import Any, Self

from incremental_mapper.candidates.model import CoreMeasurement
from incremental_mapper.config import Tree
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.frontend.match_noise import WEAK
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.base_count import BaseCount
from incremental_mapper.measurements import NANOSECONDS, Drops
from incremental_mapper.scoring.verification import Verification, verification_summary
from incremental_mapper.selection.choice import Choice
from incremental_mapper.smoothing.graph_state import GraphState

STAGES = ('front_end', 'candidates', 'solve', 'score', 'append')
MOST_HOLE = 3600 * NANOSECONDS
"""A longer hole is no driving: two clocks, or two drives in one recording."""


@dataclass(slots=True)
class Totals:
    """Running sums over the windows."""

    received: Counter[str] = field(default_factory=Counter)
    windows: int = 0
    carried_windows: int = 0
    cut_windows: int = 0
    merged_windows: int = 0
    bridges: int = 0
    solver_failures: int = 0
    failed_windows: int = 0
    time_shift: int = 0
    solver_error: float = 0.0
    enumerated: int = 0
    connected: int = 0
    solved: int = 0
    tied: int = 0
    saved: int = 0
    standing_windows: int = 0
    joined: int = 0
    doubted_imu: float = 0.0  # seconds
    scores: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    verifications: list[Verification] = field(default_factory=list)
    first_stamp: int | None = None
    last_stamp: int = 0
    skipped: int = 0  # nanoseconds of holes that are no driving

    def add_stamps(self, first: int, last: int) -> None:
        """Count a window's first and last core measurement (ns)."""
        if self.first_stamp is None:
            self.first_stamp = first
        elif first - self.last_stamp > MOST_HOLE:
            self.skipped += first - self.last_stamp
        self.first_stamp = min(self.first_stamp, first)
        self.last_stamp = max(self.last_stamp, last)

    def add_choice(self, choice: Choice) -> None:
        """Count one window's choice."""
        self.enumerated += choice.enumerated
        self.connected += choice.connected
        self.solved += choice.solved
        self.cut_windows += int(choice.cut)
        self.tied += choice.tied
        self.saved += choice.saved
        if choice.winner is None:
            self.carried_windows += 1
        else:
            self.time_shift += choice.winner.time_shift
            self.scores[choice.score_name] += 1
        if choice.verification is not None:
            self.verifications.append(choice.verification)

    def add_seconds(self, seconds: dict[str, float]) -> None:
        """Count the seconds of one window's stages."""
        self.seconds.update(seconds)


def window_row(
    index: int,
    bounds: tuple[int, int],
    core: Sequence[CoreMeasurement],
    imu_samples: int,
    choice: Choice | None,
    solver_error: float,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """One row of windows.csv; times in nanoseconds where the name says so, else in seconds."""
    winner = None if choice is None else choice.winner
    sensors = Counter(item.sensor for item in core)
    row: dict[str, Any] = {
        'window': index,
        'start_ns': bounds[0],
        'end_ns': bounds[1],
        'core': len(core),
        'sensors': ' '.join(f'{name}:{count}' for name, count in sorted(sensors.items())),
        'imu': imu_samples,
        'candidates_enumerated': choice.enumerated if choice else 0,
        'candidates_connected': choice.connected if choice else 0,
        'candidates_solved': choice.solved if choice else 0,
        'cut': int(choice.cut) if choice else 0,
        'clusters': len(winner.clusters) if winner else 0,
        'connections': len(winner.connections) if winner else 0,
        'members': '|'.join(
            '+'.join(core.sensor for core in cluster.members) for cluster in winner.clusters
        )
        if winner
        else '',
        'score_name': choice.score_name if choice and winner else '',
        'score': choice.score if choice and winner else None,
        'tied': choice.tied if choice else 0,
        'saved_vertices': choice.saved if choice else 0,
        'time_shift_s': winner.time_shift / NANOSECONDS if winner else 0.0,
        'solver_error': solver_error,
    }
    row.update({f'{stage}_s': round(seconds.get(stage, 0.0), 6) for stage in STAGES})
    row['window_s'] = round(sum(seconds.get(stage, 0.0) for stage in STAGES), 6)
    return row


KEYS = {'score_names': 'selection.score'}
"""Keys of ``stats.json`` that are no names of fields."""


@dataclass(frozen=True, slots=True)
class MapStatistics:
    """What the mapper counted: the first part of ``stats.json``, field by field a key.

    Counts of vertices and factors stand beside those of the base graph of the same measurements;
    compressions are 100 · (1 − count / base). ``score_names`` is the key ``selection.score``.
    ``candidates_tied`` counts those whose score could not be told from their window's lowest, that
    one included; ``vertices_saved_by_ties`` is what the smallest of them had less than that one.
    ``standing_windows`` are those whose ``joined_measurements`` added no variable;
    ``weak_matches`` are those that the scans hold weakly in some direction; ``doubted_imu_s`` are
    seconds of IMU samples that gather a speed which no match knows of.
    ``closures`` counts the pairs of local maps that were compared (``candidates``), the
    ``accepted`` ones, and the others by why they are no closures; empty where nothing was.
    ``verification`` is left out where nothing was verified.
    """

    strategy: str
    windows: int
    clusters: int
    vertices: int
    factors: int
    vertices_by_kind: dict[str, int]
    factors_by_kind: dict[str, int]
    base_clusters: int
    base_vertices: int
    base_factors: int
    base_factors_by_kind: dict[str, int]
    compression_vertices_percent: float
    compression_factors_percent: float
    compression_clusters_percent: float
    total_time_shift_s: float
    solver_error: float
    candidates_enumerated: int
    candidates_connected: int
    candidates_solved: int
    candidates_tied: int
    vertices_saved_by_ties: int
    standing_windows: int
    joined_measurements: int
    components: int
    carried_windows: int
    cut_windows: int
    merged_windows: int
    bridges: int
    closures: dict[str, int]
    weak_matches: int
    doubted_imu_s: float
    solver_failures: int
    failed_windows: int
    weak_priors: int
    georeferenced: bool
    score_names: dict[str, int]
    received: dict[str, int]
    late_but_used: int
    unused_measurements: int
    dropped: dict[str, dict[str, int]]
    notes: dict[str, int]
    drive_s: float
    seconds_by_stage: dict[str, float]
    settings: Tree
    verification: dict[str, Any] | None
    datum: list[float] | None

    def to_tree(self) -> dict[str, Any]:
        """The keys of ``stats.json`` in their order, as plain values."""
        tree = {KEYS.get(item.name, item.name): getattr(self, item.name) for item in fields(self)}
        if self.verification is None:
            del tree['verification']
        return tree

    @classmethod
    def from_tree(cls, tree: Mapping[str, Any]) -> Self:
        """What ``to_tree`` was made of.

        Args:
            tree: Its keys, and no others.
        """
        names = {key: name for name, key in KEYS.items()}
        made = {names.get(key, key): value for key, value in tree.items()}
        return cls(**{'verification': None, 'closures': {}, 'doubted_imu_s': 0.0, **made})


def map_statistics(
    settings: Tree,
    state: GraphState,
    base: BaseCount,
    totals: Totals,
    drops: Drops,
    notes: Counter[str],
    late: int,
    unused: Sequence[CoreMeasurement],
    datum: Datum | None,
) -> MapStatistics:
    """The record of all windows so far.

    Args:
        settings: All of them.
        state: G(t).
        base: Counts of the base graph.
        totals: Sums over the windows.
        drops: What was not used, by sensor and reason.
        notes: What was used, but not in full.
        late: Core measurements that moved to a later window.
        unused: Core measurements that wait for something that connects them.
        datum: Origin of ENU, if there is one.
    """
    by_kind = {
        'pose': len(state.clusters),
        'velocity': len(state.inertial),
        'bias': len(state.biased),
    }
    clusters, vertices = len(state.clusters), sum(by_kind.values())
    factors, kinds = len(state.factors), state.factor_counts
    drive = 0.0
    if totals.first_stamp is not None:
        passed = totals.last_stamp - totals.first_stamp - totals.skipped
        drive = passed / NANOSECONDS
    verified = totals.verifications
    return MapStatistics(
        strategy=settings['selection']['strategy'],
        windows=totals.windows,
        clusters=clusters,
        vertices=vertices,
        factors=factors,
        vertices_by_kind=by_kind,
        factors_by_kind=dict(sorted(kinds.items())),
        base_clusters=base.clusters,
        base_vertices=base.vertices,
        base_factors=base.total_factors,
        base_factors_by_kind={str(kind): count for kind, count in base.factors.items()},
        compression_vertices_percent=percent_saved(vertices, base.vertices),
        compression_factors_percent=percent_saved(factors, base.total_factors),
        compression_clusters_percent=percent_saved(clusters, base.clusters),
        total_time_shift_s=totals.time_shift / NANOSECONDS,
        solver_error=totals.solver_error,
        candidates_enumerated=totals.enumerated,
        candidates_connected=totals.connected,
        candidates_solved=totals.solved,
        candidates_tied=totals.tied,
        vertices_saved_by_ties=totals.saved,
        standing_windows=totals.standing_windows,
        joined_measurements=totals.joined,
        components=state.components.n_subsets,
        carried_windows=totals.carried_windows,
        cut_windows=totals.cut_windows,
        merged_windows=totals.merged_windows,
        bridges=totals.bridges,
        closures={},
        weak_matches=sum(count for text, count in notes.items() if text.endswith(WEAK)),
        doubted_imu_s=totals.doubted_imu,
        solver_failures=totals.solver_failures,
        failed_windows=totals.failed_windows,
        weak_priors=kinds[str(FactorKind.PRIOR_POSE)] - 1 if state.factors else 0,
        georeferenced=state.georeferenced,
        score_names=dict(totals.scores),
        received=dict(totals.received),
        late_but_used=late,
        unused_measurements=len(unused),
        dropped=_nested(drops),
        notes=dict(notes),
        drive_s=drive,
        seconds_by_stage={stage: round(totals.seconds[stage], 4) for stage in STAGES},
        settings=settings,
        verification=verification_summary(verified) if verified else None,
        datum=None if datum is None else list(astuple(datum)),
    )


def peak_rss_mb() -> float:
    """Largest resident memory of this process so far, in megabytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def percent_saved(count: int, base: int) -> float:
    """How much less a count is than that of the base graph, in percent; 0 where that has none."""
    return 100.0 * (1.0 - count / base) if base else 0.0


def _nested(drops: Drops) -> dict[str, dict[str, int]]:
    nested: dict[str, dict[str, int]] = {}
    for (sensor, reason), count in sorted(drops.items()):
        nested.setdefault(sensor, {})[reason] = count
    return nested
