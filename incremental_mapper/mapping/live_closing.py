"""Closed loops in a map that grows: found beside the windows, and put between two of them.

``LiveLoops`` asks after each window whether the drive has come near to where it was before. If so
it holds the frontier and has the search run somewhere else, on G(t) as it is in that moment
(``search_loops``). Only what comes of it changes the mapper's own G(t), at a cost that does not
grow with the drive; what was mapped during the search moves along.
"""

import pickle
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.blas import single_threaded_blas
from incremental_mapper.config import Config
from incremental_mapper.errors import MapperError
from incremental_mapper.graph.factors import Factor, closure_factor
from incremental_mapper.mapping.loop_closing import (
    MOST_ITERATIONS,
    NOT_LOOKED,
    Closed,
    Looked,
    close_more_loops,
    ends,
    find_loops,
)
from incremental_mapper.mapping.passed_places import PassedPlaces
from incremental_mapper.mapping.statistics import MapStatistics
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.correction import Evidence, evidence_on
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.variables import pose_key

PART = 300
"""Variables that are unpacked in one go, while no other thread may run: a few milliseconds."""
PACE = 2.0
"""Between two searches there is so many times the time that the last one took."""
MOST_FAILED = 3
"""Searches in a row that may fail before no more is tried."""
NO_MORE = 'no more loops are closed in this map while it grows; what is saved is searched anew'
FAILED = 'closed loops could not be put into the map'


@dataclass(frozen=True, slots=True, eq=False)
class FoundLoop:
    """A closure in plain values: clusters, (4, 4), (6, 6) and stamps (ns), see closure_factor."""

    clusters: tuple[int, int]
    T_first_second: NDArray[np.float64]
    covariance: NDArray[np.float64]
    stamps: tuple[int, int]

    def factor(self, config: Config) -> Factor:
        """It as a factor."""
        first, second = self.clusters
        return closure_factor(
            (pose_key(first), pose_key(second)),
            gtsam.Pose3(self.T_first_second),
            self.covariance,
            config.closure.robust_threshold,
            self.stamps,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What closures change of G(t) as it was; see ``GraphState.close``.

    ``older`` are values in parts, each as ``pickle`` writes them.
    """

    evidence: Evidence
    older: tuple[bytes, ...]
    left: gtsam.Values
    since: int
    shifted: float


@dataclass(frozen=True, slots=True, eq=False)
class Search:
    """What came of a search.

    Attributes:
        looked: What was looked at so far, and with what result.
        told: What ``closures`` in the statistics counts.
        loops: All closures of the map; what was not among them before is new.
        correction: What they change; None where they are those that it has already.
    """

    looked: Looked
    told: dict[str, int]
    loops: tuple[FoundLoop, ...] = ()
    correction: Correction | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Arrived:
    """A search that came back, with the values of its correction unpacked; or why none did."""

    search: Search | None
    older: gtsam.Values | None = None
    trouble: str = ''


@dataclass(frozen=True, slots=True)
class LoopNews:
    """What a user is to be told, and whether it is of something that went wrong."""

    text: str
    trouble: bool = False


class Runner(Protocol):
    """Runs one search at a time, beside the windows or not."""

    def start(self, search: Callable[[], Search]) -> bool:
        """Begin; returns whether it could."""

    def arrived(self) -> Arrived | None:
        """What came of it, once; None as long as it goes on."""

    def close(self) -> None:
        """End what goes on."""


class RunHere:
    """Runs searches at once, in this thread."""

    def __init__(self) -> None:
        self._arrived: Arrived | None = None

    def start(self, search: Callable[[], Search]) -> bool:
        """See Runner."""
        self._arrived = unpacked(search())
        return True

    def arrived(self) -> Arrived | None:
        """See Runner."""
        arrived, self._arrived = self._arrived, None
        return arrived

    def close(self) -> None:
        """See Runner."""


def unpacked(search: Search) -> Arrived:
    """A search with its values as GTSAM holds them; other threads may run between the parts.

    Args:
        search: It.
    """
    if search.correction is None:
        return Arrived(search)
    older = gtsam.Values()
    for part in search.correction.older:
        older.insert(pickle.loads(part))
    return Arrived(search, older)


@single_threaded_blas()
def search_loops(state: GraphState, config: Config, looked: Looked) -> Search:
    """Look for closed loops in G(t), and find out what they change.

    Args:
        state: G(t) whose frontier is held; it stays as it is.
        config: All settings.
        looked: What was looked at before.

    Returns:
        All closures of G(t), and what is to be done.
    """
    base = [factor.factor for factor in (*state.factors.unpacked(), *state.closures)]
    solution = optimize(make_graph(base), state.all_values(), MOST_ITERATIONS)
    if solution is None:
        return Search(looked, {})
    closed = find_loops(state, solution.values, config, looked)
    told = closed.told()
    before = {ends(factor) for factor in state.closures}
    # An empty search says nothing of the closures that there are.
    if not closed.searched or {ends(factor) for factor in closed.factors} == before:
        return Search(closed.looked, told)
    plain = [factor.factor for factor in state.factors.unpacked()]
    after = [*plain, *(factor.factor for factor in closed.factors)]
    evidence = evidence_on(state.prior, closed.values, base, after)
    correction = _correction(state, closed.values, evidence)
    loops = tuple(_plain_loop(factor) for factor in closed.factors)
    return Search(closed.looked, told, loops, correction)


def _plain_loop(factor: Factor) -> FoundLoop:
    first, second = ends(factor)
    between: Any = factor.factor
    noise = between.noiseModel()
    gaussian: Any = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
    start, end = factor.stamps
    measured = between.measured().matrix()
    return FoundLoop((first, second), measured, gaussian.covariance(), (start, end))


def _correction(state: GraphState, values: gtsam.Values, evidence: Evidence) -> Correction:
    keys = list(state.values.keys())
    parts = tuple(
        pickle.dumps(values.extract(keys[first : first + PART]))
        for first in range(0, len(keys), PART)
    )
    places = [
        (state.pose(placed.id).translation(), values.atPose3(pose_key(placed.id)).translation())
        for placed in state.clusters
    ]
    there, here = np.moveaxis(np.array(places), 1, 0)
    shifted = float(np.linalg.norm(here - there, axis=1).max())
    left = values.extract(list(state.prior.base.keys()))
    return Correction(evidence, parts, left, len(state.clusters), shifted)


class LiveLoops:
    """Closes the loops of one mapper's G(t); used in its thread, between its windows.

    ``told`` is what the statistics tell of the last search; ``closed`` counts corrections.
    """

    def __init__(self, state: GraphState, config: Config, runner: Runner) -> None:
        """Begin.

        Args:
            state: G(t), which grows elsewhere.
            config: All settings.
            runner: Where searches run.
        """
        self.told: dict[str, int] = {}
        self.closed = 0
        self._state, self._config, self._runner = state, config, runner
        self._looked = NOT_LOOKED
        self._places = PassedPlaces(config)
        self._running = False
        self._wanted = False
        self._corrections = self._failures = 0
        self._began = self._ended = -np.inf

    def step(self) -> LoopNews | None:
        """Put in what a search has found, and begin the next one where there is reason to.

        Returns:
            What a user is to be told, most often nothing.
        """
        said = None
        if self._running:
            arrived = self._runner.arrived()
            if arrived is None:
                self._wanted |= self._places.look(self._state)
                return None
            self._running = False
            said = self._take(arrived)
        self._wanted |= self._places.look(self._state)
        if self._wanted and self._failures < MOST_FAILED and self._rested():
            self._begin()
        return said

    def close(self) -> None:
        """End a search that goes on."""
        self._runner.close()

    def of_all(self, values: gtsam.Values, most: float) -> Closed:
        """All closures of G(t), for what is saved of it; what was compared is not compared again.

        Args:
            values: Its optimum, with the closures that it has.
            most: Pairs of places that are compared at the most.
        """
        return close_more_loops(self._state, values, self._config, self._looked, most)

    def counted(self, statistics: MapStatistics) -> MapStatistics:
        """The statistics of the windows with the closures that G(t) has.

        Args:
            statistics: Those without.
        """
        refused = Counter(self.told)
        searched = refused.pop('candidates', 0)
        del refused['accepted']
        closures = tuple(self._state.closures)
        return Closed(gtsam.Values(), closures, searched, refused).counted(statistics)

    def _rested(self) -> bool:
        took = self._ended - self._began
        pause = max(self._config.closure.live_period, PACE * took if np.isfinite(took) else 0.0)
        return time.monotonic() >= self._ended + pause

    def _begin(self) -> None:
        state, config, looked = self._state, self._config, self._looked
        state.hold()
        self._corrections = state.corrections
        self._began = self._ended = time.monotonic()
        self._wanted = False
        self._running = self._runner.start(lambda: search_loops(state, config, looked))
        if not self._running:
            state.release()

    def _take(self, arrived: Arrived) -> LoopNews | None:
        state, search = self._state, arrived.search
        self._ended = time.monotonic()
        if search is None:
            state.release()
            return self._failed(arrived.trouble)
        self._failures = 0
        self._looked = search.looked
        self.told = search.told or self.told
        if search.correction is None:
            state.release()
            return None
        assert arrived.older is not None
        if state.corrections != self._corrections:
            # All of G(t) was turned or solved anew meanwhile: what was found is found again.
            state.release()
            self._wanted = True
            return None
        correction = search.correction
        before = len(state.closures)
        try:
            state.close(
                [loop.factor(self._config) for loop in search.loops],
                correction.evidence,
                arrived.older,
                correction.left,
                correction.since,
                correction.shifted,
            )
        except MapperError:
            raise
        except (RuntimeError, ValueError, np.linalg.LinAlgError):
            state.release()
            return self._failed(FAILED)
        self.closed += 1
        self._places.again(state)
        moved = float(np.linalg.norm(correction.evidence.T_new_old.translation()))
        return LoopNews(
            f'loops closed: {len(state.closures)} closures, {len(state.closures) - before} more '
            f'than before; the map has moved by up to {correction.shifted:.2f} m, and by '
            f'{moved:.2f} m where the vehicle was'
        )

    def _failed(self, trouble: str) -> LoopNews | None:
        """What is said of a search that failed: once, and that no more is tried."""
        self._failures += 1
        self._wanted = True
        if self._failures == MOST_FAILED:
            return LoopNews(f'{trouble}; {NO_MORE}', trouble=True)
        return LoopNews(trouble, trouble=True) if self._failures == 1 else None


def live(config: Config) -> bool:
    """Whether loops are closed in a map that grows."""
    closure = config.closure
    return closure.enabled and closure.live_period > 0.0 and config.graph.final_optimization
