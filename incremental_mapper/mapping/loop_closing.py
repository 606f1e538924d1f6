"""Loop closure of a whole map: closures found among its local maps, put into it, and judged again.

They come after the windows: no candidate of a window competes with them, and G(t) stays as it is.
"""

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import gtsam
import numpy as np

from incremental_mapper.closures.candidate_pairs import (
    INSTALL,
    Candidate,
    by_place,
    can_recognise,
)
from incremental_mapper.closures.local_maps import LocalMap, Stretch, cut_local_maps, cut_way
from incremental_mapper.closures.search import Found, Pair, Tested, find_closures, in_order
from incremental_mapper.closures.verification import conceivable
from incremental_mapper.config import ClosureSettings, Config
from incremental_mapper.errors import OutputError
from incremental_mapper.graph.factors import Factor, FactorKind, closure_factor
from incremental_mapper.mapping.known_places import KnownPlaces
from incremental_mapper.mapping.statistics import MapStatistics, percent_saved
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import cluster_of, pose_key

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
class Looked:
    """What searches of a map that grows have looked at: its way as they cut it, and pairs of it."""

    stretches: tuple[Stretch, ...] = ()
    tested: Tested = field(default_factory=dict)


NOT_LOOKED = Looked()


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """A map with its loops closed.

    ``factors`` are the closures, ``values`` what all of it says; ``searched`` counts the candidates
    and ``refused`` why some of them are no closures. ``note`` is a remark for the user; ``looked``
    is what need not be looked at again.
    """

    values: gtsam.Values
    factors: tuple[Factor, ...] = ()
    searched: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    note: str = ''
    looked: Looked = NOT_LOOKED

    def told(self) -> dict[str, int]:
        """What statistics tell of it; empty where nothing was compared."""
        counted = {'candidates': self.searched, 'accepted': len(self.factors)}
        return {**counted, **dict(sorted(self.refused.items()))} if self.searched else {}

    def counted(self, statistics: MapStatistics) -> MapStatistics:
        """The statistics of the windows with what was found after them.

        Args:
            statistics: Those of the map without closures.
        """
        if not self.searched and not self.note:
            return statistics
        more = len(self.factors)
        kinds = Counter(statistics.factors_by_kind) + Counter({str(FactorKind.CLOSURE): more})
        total = statistics.factors + more
        return replace(
            statistics,
            factors=total,
            factors_by_kind=dict(sorted(kinds.items())),
            compression_factors_percent=percent_saved(total, statistics.base_factors),
            closures=self.told() or {'candidates': 0, 'accepted': 0},
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
    stretches = cut_way(state.clusters, values, settings.map_length)

    def cut(wanted: Collection[int] | None) -> list[LocalMap]:
        clusters, scans = state.clusters, state.scans
        return cut_local_maps(stretches, clusters, scans, values, settings, wanted=wanted)

    maps = cut(())
    if not maps or maps[-1].travelled - maps[0].travelled < settings.min_travel:
        return Closed(values)
    places = _known_places(state.factors.unpacked(), values)
    if places is None:
        return Closed(values)
    unsure = places.unsure(maps, settings) if can_recognise() else []
    # To cut one takes a tenth of a second: only what is looked at.
    wanted = {maps[place].cluster for place in unsure}
    for pair in by_place(maps, settings):
        wanted |= {maps[pair.first].cluster, maps[pair.second].cluster}
    if wanted:
        try:
            maps = cut(wanted)
        except OutputError:
            return Closed(values, note=UNREADABLE)
    found = find_closures(
        maps, places.relative, settings, config.odometry, recognise=unsure, once=True
    )
    return _closed(state, maps, found, values, config, _library_note(stretches, settings))


def find_loops(state: GraphState, values: gtsam.Values, config: Config, looked: Looked) -> Closed:
    """As ``close_loops`` for a map that grows: what was compared before is not compared again.

    Only what lies near each other is compared: places that look alike are left to what is saved.

    Args:
        state: G(t), which stays as it is.
        values: Its optimum, with the closures that it has.
        config: All settings.
        looked: What was looked at before.

    Returns:
        All closures, those that the map has among them, and the values with them; where no pair is
        new, ``values`` and no factors.
    """
    # The newest stretch is not whole.
    stretches = cut_way(state.clusters, values, config.closure.map_length, looked.stretches)[:-1]
    found = _more(state, stretches, values, config, looked, math.inf, False, once=False)
    return Closed(values, looked=looked) if found is None else found


def close_more_loops(
    state: GraphState, values: gtsam.Values, config: Config, looked: Looked, most: float
) -> Closed:
    """As ``close_loops`` for a map whose loops were closed while it grew, for what is saved of it.

    Args:
        state: G(t), which stays as it is.
        values: Its optimum, with the closures that it has.
        config: All settings.
        looked: What was looked at before.
        most: Pairs that are registered at the most.

    Returns:
        All closures, and the values with them.
    """
    settings = config.closure
    stretches = cut_way(state.clusters, values, settings.map_length, looked.stretches)
    found = _more(state, stretches, values, config, looked, most, can_recognise(), once=True)
    closed = found or Closed(values, tuple(state.closures))
    return replace(closed, note=_library_note(stretches, settings))


def _more(
    state: GraphState,
    stretches: Sequence[Stretch],
    values: gtsam.Values,
    config: Config,
    looked: Looked,
    most: float,
    recognise: bool,
    once: bool,
) -> Closed | None:
    """What there is beyond what was looked at; None where there is nothing to be compared."""
    settings, tested = config.closure, looked.tested

    def cut(wanted: Collection[int] | None) -> list[LocalMap]:
        clusters, scans = state.clusters, state.scans
        return cut_local_maps(stretches, clusters, scans, values, settings, wanted=wanted)

    maps = cut(())

    def names(pair: Candidate) -> Pair:
        return maps[pair.first].cluster, maps[pair.second].cluster

    untested = [pair for pair in by_place(maps, settings) if names(pair) not in tested]
    if not untested and not recognise:
        return None
    plain = state.factors.unpacked()
    places = _known_places((*plain, *state.closures), values)
    # Closures that there are do not make a drive one that needs no more of them.
    alone = _known_places(plain, values) if recognise and state.closures else places
    if places is None or alone is None:
        return None
    unsure = alone.unsure(maps, settings) if recognise else []
    if not untested and not unsure:
        return None
    if most < len(untested):
        # Points of those alone that will be registered: to cut all took most of a save.
        untested = list(
            islice(
                (
                    pair
                    for pair in sorted(untested, key=in_order)
                    if conceivable(pair, places.relative(maps[pair.first], maps[pair.second]))
                ),
                int(most),
            )
        )
    wanted = {cluster for pair in untested for cluster in names(pair)}
    try:
        maps = cut(wanted | {maps[place].cluster for place in unsure})
    except OutputError:
        return None
    closed = {ends(factor) for factor in state.closures}
    found = find_closures(
        maps,
        places.relative,
        settings,
        config.odometry,
        recognise=unsure,
        tested=tested,
        most=most,
        closed=closed,
        once=once,
    )
    more = _closed(state, maps, found, values, config, '')
    return replace(more, looked=Looked(tuple(stretches), found.tested))


def _library_note(stretches: Sequence[Stretch], settings: ClosureSettings) -> str:
    """A remark where a map may have drifted further than it is looked for."""
    short = len(stretches) * settings.map_length < RECOGNISE_FROM
    return '' if short or can_recognise() else NO_LIBRARY


def _known_places(factors: Sequence[Factor], values: gtsam.Values) -> KnownPlaces | None:
    """Where the local maps lie; None where it cannot be told what is known already."""
    try:
        return KnownPlaces(factors, values)
    except RuntimeError:
        # A singular system: without knowing what is known, no closure can be held against it.
        return None


def _closed(
    state: GraphState,
    maps: Sequence[LocalMap],
    found: Found,
    values: gtsam.Values,
    config: Config,
    note: str,
) -> Closed:
    factors = tuple(
        closure_factor(
            (pose_key(maps[one.first].cluster), pose_key(maps[one.second].cluster)),
            one.T_first_second,
            one.covariance,
            config.closure.robust_threshold,
            (maps[one.first].stamp, maps[one.second].stamp),
        )
        for one in found.closures
    )
    plain = [factor.factor for factor in state.factors.unpacked()]
    solved = solve_with_closures(plain, factors, values)
    refused = found.refused + Counter(refuted=len(factors) - len(solved.factors))
    return replace(
        solved,
        searched=found.candidates,
        refused=refused,
        note=note,
    )


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


def ends(closure: Factor) -> Pair:
    """The clusters that a closure relates."""
    first, second = (cluster_of(key) for key in closure.keys)
    return first, second


def _distance(closure: Factor, values: gtsam.Values) -> float:
    """Squared Mahalanobis distance of a closure from a solved map."""
    apart = closure.factor.unwhitenedError(values)  # type: ignore[attr-defined]
    noise = closure.factor.noiseModel()  # type: ignore[attr-defined]
    gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    return float(np.square(gaussian.whiten(apart)).sum())
