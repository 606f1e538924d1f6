"""A street driven there and back, by odometry that drifts: closed loops take the drift away."""

from collections import Counter
from itertools import pairwise

import gtsam
import numpy as np
import pytest
from town import pose, seen_points, town

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.closures.candidate_pairs import can_recognise
from incremental_mapper.closures.local_maps import LocalMap, cut_local_maps, cut_way
from incremental_mapper.config import Config
from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    closure_factor,
    pose_prior,
    pose_sigmas,
)
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.mapping.known_places import KnownPlaces
from incremental_mapper.mapping.loop_closing import close_loops, solve_with_closures
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.graph_state import GraphState, PlacedCluster, PlacedScan
from incremental_mapper.smoothing.relative_covariance import RelativeCovariances
from incremental_mapper.variables import pose_key

SCANS_EVERY = 4
STEP = np.diag(pose_sigmas(0.03, 0.003) ** 2)
SETTINGS = Config.model_validate({'closure': {'candidates': 1}})


def way():
    """True poses a metre apart: 80 m there, a turn, and 80 m back on the other side."""
    there = [pose(float(x), 0.0) for x in range(-40, 40)]
    turn = [pose(40.0 + 1.5 * np.sin(a), 1.5 - 1.5 * np.cos(a), np.degrees(a)) for a in
            np.linspace(0.2, np.pi - 0.2, 6)]  # fmt: skip
    return [*there, *turn, *(pose(float(x), 3.0, 180.0) for x in range(40, -41, -1))]


@pytest.fixture(scope='module')
def drive():
    """G(t) of that way, whose odometry reads 1 % too little and turns to the left on its own."""
    true, points, store = way(), town(1), MemoryStore()
    state = GraphState(store=store)
    believed = [true[0]]
    state.factors.append(pose_prior(pose_key(0), true[0], pose_sigmas(0.01, 0.001), 0))
    for number, (before, after) in enumerate(pairwise(true)):
        motion = before.between(after)
        wrong = gtsam.Pose3(
            motion.rotation().compose(gtsam.Rot3.Yaw(5e-4)),
            0.99 * motion.translation(),
        )
        believed.append(believed[-1].compose(wrong))
        keys = pose_key(number), pose_key(number + 1)
        state.factors.append(
            between_factor(FactorKind.ODOMETRY, keys, wrong, STEP, 'top', (number, number + 1))
        )
    for number, (own, where) in enumerate(zip(true, believed, strict=True)):
        core = CoreMeasurement(number, 'top', CoreKind.LIDAR)
        state.clusters.append(PlacedCluster(number, number, Cluster((core,))))
        state.values.insert(pose_key(number), where)
        if number % SCANS_EVERY == 0:
            stored = store.put(seen_points(points, own, number, 0.15))
            state.scans.append(PlacedScan(number, number, 'top', stored, gtsam.Pose3()))
    return state, true


def errors(values, true):
    return np.array(
        [
            np.linalg.norm(values.atPose3(pose_key(i)).translation() - own.translation())
            for i, own in enumerate(true)
        ]
    )


def test_a_way_back_takes_the_drift_away(drive):
    state, true = drive
    before = state.all_values()
    factors = len(state.factors)
    closed = close_loops(state, before, SETTINGS)
    assert len(closed.factors) >= 3 and closed.searched >= len(closed.factors)
    assert all(one.kind is FactorKind.CLOSURE for one in closed.factors)
    assert errors(before, true)[-1] > 1.0 and errors(closed.values, true)[-1] < 0.2
    for one in closed.factors:
        first, second = (true[stamp] for stamp in one.stamps)
        off = gtsam.Pose3.Logmap(first.between(second).between(one.factor.measured()))
        assert np.abs(off[3:]).max() < 0.1 and np.abs(off[:3]).max() < 0.005
    assert len(state.factors) == factors and state.all_values().equals(before, 0.0)


def with_fixes(state, true, every=10):
    """The same drive, whose poses are known to 0.3 m now and then; its values are solved."""
    fixes = [
        pose_prior(pose_key(number), true[number], pose_sigmas(0.3, 0.1), number)
        for number in range(0, len(true), every)
    ]
    factors = [*state.factors, *fixes]
    graph = make_graph(factor.factor for factor in factors)
    values = optimize(graph, state.all_values(), 100).values
    clusters, scans = state.clusters, state.scans
    return GraphState(factors=factors, clusters=clusters, scans=scans, values=values)


def test_what_a_drive_knows_of_its_places(drive):
    state, true = drive
    held = with_fixes(state, true)
    for known, certain in ((state, False), (held, True)):
        values = known.all_values()
        stretches = cut_way(known.clusters, values, 20.0)
        maps = cut_local_maps(
            stretches, known.clusters, known.scans, values, SETTINGS.closure, wanted=()
        )
        places = KnownPlaces(known.factors, values)
        assert (places.unsure(maps, SETTINGS.closure) == []) is certain
        near = SETTINGS.closure.model_copy(update={'radius': 10.0})
        assert places.unsure(maps, near)  # neighbours may lie that far apart
        marginals = gtsam.Marginals(
            make_graph(factor.factor for factor in known.factors), values
        ).marginalCovariance(pose_key(80))
        expected = np.sqrt(np.linalg.eigvalsh(marginals[3:, 3:])[-1])
        plain = (factor.factor for factor in known.factors)
        position = RelativeCovariances(plain, values)
        assert position.position(pose_key(80)) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(
    ('sigma', 'among'), [(0.1, set()), (3.0, set()), (9.0, {20, 21, 22, 77, 78, 79})]
)
def test_only_what_may_be_one_place_is_compared_by_its_looks(monkeypatch, sigma, among):
    # There and back on a street 40 m away; fixes hold all of it but three local maps.
    nothing = np.zeros((0, 3), dtype=np.float32)
    way = [(20.0 * n, 0.0) for n in range(50)] + [(20.0 * (99 - n), 40.0) for n in range(50, 100)]
    maps = [
        LocalMap(n, n, gtsam.Pose3(gtsam.Rot3(), [x, y, 0.0]), 20.0 * n, nothing)
        for n, (x, y) in enumerate(way)
    ]
    sigmas = np.full(len(maps), 0.05)
    sigmas[20:23] = sigma
    places = KnownPlaces.__new__(KnownPlaces)
    monkeypatch.setattr(places, '_positions', lambda _: sigmas)
    found = set(places.unsure(maps, SETTINGS.closure))
    assert among <= found and (found == set()) == (among == set())
    # Those that drifted, what lies within their reach, and nothing further away.
    reach = 6.0 * (sigma + 0.05) + 10.0
    for number in found:
        near = min(np.hypot(*np.subtract(way[number], way[one])) for one in (20, 21, 22))
        assert near <= max(reach, 6.0 * 2.0 * sigma + 10.0)


def test_places_that_fixes_hold_are_not_recognised_by_their_looks(drive):
    state, true = drive
    held = with_fixes(state, true)
    near = SETTINGS.model_copy(
        update={'closure': SETTINGS.closure.model_copy(update={'min_travel': 140.0})}
    )
    # All but the ends are too short a way from each other: what is compared lies side by side.
    closed = close_loops(held, held.all_values(), near)
    assert closed.searched == 1
    if can_recognise():
        assert close_loops(state, state.all_values(), near).searched > 1


def test_switched_off_it_leaves_all_as_it_is(drive):
    state, _ = drive
    values = state.all_values()
    for section in ({'closure': {'enabled': False}}, {'graph': {'final_optimization': False}}):
        closed = close_loops(state, values, Config.model_validate(section))
        assert closed.values is values and closed.factors == () and closed.searched == 0


def test_a_closure_that_the_map_refutes_is_taken_out(drive):
    state, true = drive
    values = state.all_values()
    ends = [(2, 162), (10, 154), (20, 144), (30, 134)]
    noise = np.diag(pose_sigmas(0.05, 0.003) ** 2)

    def closure(first, second, off):
        measured = true[first].between(true[second]).compose(pose(off, 0.0))
        keys = pose_key(first), pose_key(second)
        return closure_factor(keys, measured, noise, 3.0, (first, second))

    closures = tuple(closure(*pair, 6.0 * (pair[0] == 20)) for pair in ends)
    good = (closures[0], closures[1], closures[3])
    plain = [factor.factor for factor in state.factors]
    found = solve_with_closures(plain, closures, values)
    assert found.factors == good
    assert found.values.equals(solve_with_closures(plain, good, values).values, 1e-4)


def test_counts_of_a_map_without_candidates_are_empty():
    assert close_loops(GraphState(), gtsam.Values(), Config()).refused == Counter()
