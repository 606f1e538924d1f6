"""Loop closure of a whole map: closures found among its local maps, put into it, and judged again.

They come after the windows: no candidate of a window competes with them, and G(t) stays as it is.
"""

from collections import Counter
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np

from incremental_mapper.closures.candidate_pairs import INSTALL, Known, can_recognise
from incremental_mapper.closures.local_maps import LocalMap, cut_local_maps
from incremental_mapper.closures.search import find_closures
from incremental_mapper.config import Config
from incremental_mapper.errors import OutputError
from incremental_mapper.graph.factors import Factor, FactorKind, closure_factor
from incremental_mapper.mapping.statistics import MapStatistics, percent_saved
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key

MOST_ITERATIONS = 100
REFUTED = 22.5
"""Squared distance, in standard deviations, of a closure from the map that was solved with it, from
which on it is left out: one in a thousand is further off by chance."""
ROUNDS = 3
"""How often the map is solved at the most, each time without the closures that it has refuted."""
UNREADABLE = 'no loop was closed, since a scan cannot be read back'
RECOGNISE_FROM = 300.0
"""Metres of way from which on a map may have drifted by more than ``closure.radius``."""
NO_LIBRARY = f'places are recognised only where they are thought to be: {INSTALL}'


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """A map with its loops closed.

    ``factors`` are the closures, ``values`` what all of it says; ``searched`` counts the candidates
    and ``refused`` why some of them are no closures. ``note`` is a remark for the user.
    """

    values: gtsam.Values
    factors: tuple[Factor, ...] = ()
    searched: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    note: str = ''

    def counted(self, statistics: MapStatistics) -> MapStatistics:
        """The statistics of the windows with what was found after them.

        Args:
            statistics: Those of the map without closures.
        """
        if not self.searched and not self.note:
            return statistics
        more = len(self.factors)
        told = {'candidates': self.searched, 'accepted': more, **dict(sorted(self.refused.items()))}
        kinds = Counter(statistics.factors_by_kind) + Counter({str(FactorKind.CLOSURE): more})
        total = statistics.factors + more
        return replace(
            statistics,
            factors=total,
            factors_by_kind=dict(sorted(kinds.items())),
            compression_factors_percent=percent_saved(total, statistics.base_factors),
            closures=told,
            notes={**statistics.notes, **({self.note: 1} if self.note else {})},
        )


def close_loops(state: GraphState, values: gtsam.Values, config: Config) -> Closed:
    """Look for places that a drive passes again, and solve its map with what they say.

    Args:
        state: G(t), which stays as it is.
        values: Its optimum.
        config: All settings.

    Returns:
        The closures, and the values with them; where there are none, ``values``.
    """
    settings = config.closure
    if not settings.enabled or not config.graph.final_optimization:
        return Closed(values)
    try:
        maps = cut_local_maps(state.clusters, state.scans, values, settings)
    except OutputError:
        return Closed(values, note=UNREADABLE)
    if not maps or maps[-1].travelled - maps[0].travelled < settings.min_travel:
        return Closed(values)
    plain = [factor.factor for factor in state.factors]
    try:
        covariances = RelativeCovariances(plain, values)
    except RuntimeError:
        # A singular system: without knowing what is known, no closure can be held against it.
        return Closed(values)

    def relative(first: LocalMap, second: LocalMap) -> Known:
        covariance = covariances.relative(pose_key(first.cluster), pose_key(second.cluster))
        return Known(first.T_map_base.between(second.T_map_base), covariance)

    found = find_closures(maps, relative, settings, config.odometry)
    factors = tuple(
        closure_factor(
            (pose_key(maps[one.first].cluster), pose_key(maps[one.second].cluster)),
            one.T_first_second,
            one.covariance,
            settings.robust_threshold,
            (maps[one.first].stamp, maps[one.second].stamp),
        )
        for one in found.closures
    )
    told = maps[-1].travelled < RECOGNISE_FROM or can_recognise()
    note = '' if told else NO_LIBRARY
    solved = solve_with_closures(plain, factors, values)
    kept = len(solved.factors)
    refused = found.refused + Counter(refuted=len(factors) - kept)
    return Closed(solved.values, solved.factors, found.candidates, refused, note)


def solve_with_closures(
    plain: list[gtsam.NonlinearFactor], factors: tuple[Factor, ...], values: gtsam.Values
) -> Closed:
    """The map solved with closures, without those that it refutes.

    Args:
        plain: All other factors.
        factors: The closures.
        values: The optimum without them.

    Returns:
        The closures that are left, and the values with them.
    """
    for _ in range(ROUNDS):
        if not factors:
            break
        graph = make_graph([*plain, *(factor.factor for factor in factors)])
        solution = optimize(graph, values, MOST_ITERATIONS)
        if solution is None:
            break
        held = tuple(one for one in factors if _distance(one, solution.values) <= REFUTED)
        if len(held) == len(factors):
            return Closed(solution.values, factors)
        factors = held
    return Closed(values)


def _distance(closure: Factor, values: gtsam.Values) -> float:
    """Squared Mahalanobis distance of a closure from a solved map."""
    apart = closure.factor.unwhitenedError(values)  # type: ignore[attr-defined]
    noise = closure.factor.noiseModel()  # type: ignore[attr-defined]
    gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    return float(np.square(gaussian.whiten(apart)).sum())
