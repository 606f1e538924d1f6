"""Prefixes of the beam: which ones there are, what they cost, and where they put the scans."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turning_car import CHAINS, MS, imu_series, known_state, motion, problem_of, truth, windows
from turning_car import settings as car_settings

import incremental_mapper.selection.beam_search as beam_module
from incremental_mapper.candidates.enumeration import candidates
from incremental_mapper.scoring.criteria import ByFunction
from incremental_mapper.selection.beam_search import beam_search
from incremental_mapper.smoothing.candidate_solver import CandidateSolver
from incremental_mapper.smoothing.graph_state import GraphState

UNLIMITED = 1e6


def searched(problem, score=lambda proposal: 0.0, width=10_000, seconds=UNLIMITED):
    return beam_search(problem, lambda *_: ByFunction('test', score), width, seconds)


def connected(problem):
    every = candidates(problem.elements, problem.head, problem.imu)
    return [item for item in every if not problem.unconnected(item)]


def sparse(stamps, moments):
    """Samples of the IMU at some moments (10 ms) only."""
    series = imu_series(-50 * MS, max(stamps) + 50 * MS, MS)
    keep = np.isin(series.stamps // (10 * MS), sorted(moments)) & (series.stamps % (10 * MS) == 0)
    return replace(
        series,
        stamps=series.stamps[keep],
        gyro=series.gyro[keep],
        acceleration=series.acceleration[keep],
    )


@settings(deadline=None, max_examples=20)
@given(
    windows(4), st.none() | st.sets(st.integers(-2, 31), max_size=12), st.booleans(), st.booleans()
)
def test_no_connected_candidate_is_missed_by_a_beam_that_drops_nothing(
    stamps, moments, first, reckoned
):
    state = GraphState() if first else known_state()
    graph = {'motion_compensation': False, 'dead_reckoning': reckoned}
    config = car_settings(graph=graph, preintegration={'max_gap': 0.12})
    series = None if moments is None else sparse(stamps, moments)
    problem = problem_of(stamps, state, config, series)
    found = searched(problem)
    assert len(set(found)) == len(found)
    every = set(candidates(problem.elements, problem.head, problem.imu))
    assert set(found) <= every
    if moments is None:
        assert set(connected(problem)) <= set(found)
    # Where samples are rare, a cluster is not passed by if nothing later goes on from before it.
    reached = set(connected(problem)) & set(found)
    assert bool(reached) == bool(connected(problem))


WINDOW = {40 * MS: {'left'}, 62 * MS: {'gps'}, 97 * MS: {'right'}, 140 * MS: {'left'}}


def test_cost_of_a_prefix_is_that_of_its_factors_and_of_what_it_moves_before():
    state = known_state(sigma=0.05)
    problem = problem_of(WINDOW, state)
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[:] += [0.1, -0.1, 0.05]
    costs = {}

    def score(proposal):
        costs[proposal.candidate] = proposal.solver_error
        return proposal.solver_error

    found = searched(problem, score)
    solver = CandidateSolver(problem.prior, problem.factors, problem.guess, 30)
    known = {item: solver.solve(item) for item in connected(problem)}
    for candidate in connected(problem):
        solved = solver.refine(candidate, known[candidate])
        assert costs[candidate] == pytest.approx(solved.cost, rel=0.02, abs=0.02)
    # Best first, and among equals the one with fewer variables.
    order = [(costs[item], item.vertices) for item in found]
    assert order == sorted(order)
    shorter = [cost for item, cost in costs.items() if item.clusters[-1:] and cost > 1.0]
    assert shorter  # the fix is felt as soon as it is placed


@settings(deadline=None, max_examples=10)
@given(windows(4))
def test_scans_that_a_prefix_has_not_placed_yet_are_where_dead_reckoning_puts_them(stamps):
    problem = problem_of(stamps)
    new = [core.stamp for core in problem.inputs.prepared if core.kind == 'lidar']
    expected = np.array([truth(stamp).matrix() for stamp in [*new, *CHAINS.values()]])
    lengths = set()

    def score(proposal):
        assert proposal.poses == pytest.approx(expected, abs=0.02)
        lengths.add(len(proposal.candidate.clusters))
        return 0.0

    searched(problem, score, width=6)
    assert max(lengths) >= 1 and min(lengths) == 0


def test_prefix_that_was_put_right_takes_the_rest_of_the_window_along():
    # The fix says that the car is a metre further to the north.
    stamps = {40 * MS: {'left'}, 140 * MS: {'gps', 'right'}, 190 * MS: {'left'}}
    problem = problem_of(stamps, known_state(sigma=0.5))
    (moved,) = [item for item in problem.inputs.prepared.values() if item.core.sensor == 'gps']
    moved.enu[:] += [0.0, 1.0, 0.0]
    seen = {}

    def score(proposal):
        bounds = tuple((cluster.first, cluster.last) for cluster in proposal.candidate.clusters)
        seen[bounds] = proposal.poses
        return 0.0

    searched(problem, score)
    before, after = seen[(0, 0),], seen[(0, 0), (1, 1)]
    # Placed by the fix, the last scan moves with the cluster before it, as the car went on.
    assert 0.1 < np.linalg.norm(after[2, :3, 3] - before[2, :3, 3]) < 2.0
    went = np.linalg.inv(after[1]) @ after[2]
    assert went == pytest.approx(motion(140 * MS, 190 * MS).matrix(), abs=5e-3)


@pytest.mark.parametrize('width', [1, 2, 3])
def test_no_more_prefixes_of_a_length_are_extended_than_the_beam_is_wide(width):
    problem = problem_of({**WINDOW, 165 * MS: {'gps'}, 197 * MS: {'right'}})
    layers = {}

    def score(proposal):
        placed = proposal.candidate.clusters[-1].last + 1 if proposal.candidate.clusters else 0
        layers.setdefault(placed, set()).add(proposal.candidate)
        return float(len(proposal.candidate.clusters))

    searched(problem, score, width)
    parents = {}
    for some in layers.values():
        for item in some:
            if item.clusters:
                end = item.clusters[-1].first
                links = tuple(c for c in item.connections if c.end < len(item.clusters) - 1)
                parents.setdefault(end, set()).add((item.clusters[:-1], links))
    for found in parents.values():
        # A parent may go on with or without a link of its last cluster.
        assert len({clusters for clusters, _ in found}) <= width


def test_best_prefixes_are_kept():
    problem = problem_of({**WINDOW, 165 * MS: {'gps'}, 197 * MS: {'right'}})
    # Many clusters are wanted: with a beam of one, nothing is ever merged.
    found = searched(problem, lambda proposal: -float(len(proposal.candidate.clusters)), 1)
    assert len(found[0].clusters) == len(problem.elements)
    few = searched(problem, lambda proposal: float(len(proposal.candidate.clusters)), 30)
    assert len(few[0].clusters) < len(problem.elements) - 2


def test_as_many_finalists_as_can_be_solved_together_and_eight_at_the_least():
    problem = problem_of({**WINDOW, 165 * MS: {'gps'}, 197 * MS: {'right'}})
    assert len(searched(problem, width=50)) == 240 // 6 < len(connected(problem))
    many = {(20 + 10 * i) * MS: {'left'} for i in range(31)}
    assert len(searched(problem_of(many), width=10)) == 8


def test_search_without_time_keeps_one_prefix_of_each_length_and_gives_a_result():
    problem = problem_of({**WINDOW, 165 * MS: {'gps'}, 197 * MS: {'right'}})
    counts = []

    def score(proposal):
        counts.append(proposal.candidate)
        return 0.0

    found = searched(problem, score, seconds=0.0)
    assert found and len(found) <= 24
    hurried, counts = len(counts), []
    searched(problem, score, width=8)
    assert hurried < len(counts)


def test_nothing_is_merged_while_the_velocity_is_unknown():
    problem = replace(problem_of(WINDOW), may_merge=False)
    found = searched(problem)
    assert found and not any(item.merges for item in found)


def test_prefix_that_cannot_be_solved_is_not_extended():
    problem = problem_of(WINDOW)
    (seen,) = [item for item in problem.inputs.prepared.values() if item.core.kind == 'gnss']
    seen.enu[0] = np.nan
    assert searched(problem) == []


@pytest.mark.parametrize(
    ('position', 'spent', 'extended', 'width'),
    [
        (0, 0.0, 0, 50),  # nothing is known yet of the pace
        (4, 2.0, 40, 26),  # 8 s left for 6 layers at 0.05 s an extension
        (4, 2.0, 400, 50),  # the beam is wide enough to be cheap
        (2, 4.0, 300, 18),  # each prefix has three extensions: 6 s / 8 / 0.0133 s / 3
        (4, 12.0, 40, 1),  # no time is left
        (9, 9.9, 40, 1),
    ],
)
def test_beam_is_as_wide_as_the_pace_so_far_allows(monkeypatch, position, spent, extended, width):
    problem = problem_of({(20 + 10 * i) * MS: {'left'} for i in range(10)})
    monkeypatch.setattr(beam_module.time, 'perf_counter', lambda: 100.0 + spent)
    search = beam_module._Search(problem, lambda *_: ByFunction('', float), 50, 10.0)
    assert search._width(position, 100.0, extended) == width


def test_criterion_of_prefixes_is_told_of_scans_near_dead_reckoning():
    problem = problem_of(WINDOW)
    seen = []

    def make(_, proposals, exact):
        assert not exact
        seen.extend(proposal.poses for proposal in proposals)
        return ByFunction('test', lambda proposal: 0.0)

    beam_search(problem, make, 4, UNLIMITED)
    new = [core.stamp for core in problem.inputs.prepared if core.kind == 'lidar']
    expected = np.array([truth(stamp).matrix() for stamp in [*new, *CHAINS.values()]])
    middle, one, other = seen
    assert middle == pytest.approx(expected, abs=2e-3)
    # Every other scan is moved the other way, by four centimetres against each other.
    steps = one - middle
    assert steps[:, :3, 3] == pytest.approx(
        np.array([[0.02, 0.0, 0.02], [-0.02, 0.0, -0.02]] * 3)[: len(steps)], abs=1e-12
    )
    assert np.abs(steps[:, :3, :3]).max() == 0.0
    assert other - middle == pytest.approx(-steps, abs=1e-12)


def test_prefix_that_cannot_come_to_hang_on_anything_is_not_pursued():
    # A fix has no odometry: passed by, it would stay alone.
    problem = problem_of({(20 + 10 * i) * MS: {'gps'} for i in range(6)})
    found = searched(problem)
    assert len(found) == 2**5
    assert not any(problem.unconnected(item) for item in found)


def test_nothing_that_waits_for_evidence_is_part_of_a_search():
    """Its steps eliminate more, and the held variables are not all among those left to it."""
    state = known_state()
    state.hold()
    assert state.prior.held
    assert not problem_of({20 * MS: ['gps']}, state).prior.held
