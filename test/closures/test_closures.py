"""Closures among local maps of an invented town: found where they are, and nowhere else."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from town import pose, seen_points, town, wall

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.closures import verification
from incremental_mapper.closures.candidate_pairs import (
    Candidate,
    Known,
    by_looks,
    by_place,
    comparable,
)
from incremental_mapper.closures.consistency import consistent_set
from incremental_mapper.closures.local_maps import LocalMap, cut_way
from incremental_mapper.closures.search import LEFT, find_closures
from incremental_mapper.closures.verification import Closure, Verifier, conceivable
from incremental_mapper.config import ClosureSettings, OdometrySettings
from incremental_mapper.smoothing.graph_state import PlacedCluster
from incremental_mapper.variables import pose_key

SETTINGS, ODOMETRY = ClosureSettings(), OdometrySettings()
TIGHT = np.diag(np.square([0.01] * 3 + [0.3] * 3))
LOOSE = np.diag(np.square([0.3] * 3 + [30.0] * 3))


def seen(points, true, number, believed=None, travelled=0.0, run=0):
    """A local map of what lies within 40 m, by another set of the points each time."""
    believed = true if believed is None else believed
    return LocalMap(number, number, believed, travelled, seen_points(points, true, number), run)


TOWN = town(1)
FIRST, AGAIN = pose(0.0, 0.0), pose(4.0, 5.0, 178.0)


@pytest.fixture(scope='module')
def maps():
    """A place, the same the other way round with 1.5 m of drift, and another one."""
    drifted = AGAIN.compose(pose(1.2, -0.9, 1.0))
    return [
        seen(TOWN, FIRST, 1),
        seen(TOWN, AGAIN, 2, drifted, 500.0),
        seen(town(2), AGAIN, 3, drifted, 900.0),
    ]


def known(maps, first, second, covariance):
    relative = maps[first].T_map_base.between(maps[second].T_map_base)
    return Known(relative, covariance)


def test_the_same_place_the_other_way_round_is_a_closure_with_the_true_relative_pose(maps):
    candidate = by_place(maps[:2], SETTINGS)[0]
    found = Verifier(maps, SETTINGS, ODOMETRY).verify(candidate, known(maps, 0, 1, LOOSE))
    assert isinstance(found, Closure) and (found.first, found.second) == (0, 1)
    off = gtsam.Pose3.Logmap(FIRST.between(AGAIN).between(found.T_first_second))
    assert np.abs(off[3:]).max() < 0.05 and np.abs(off[:3]).max() < 0.003
    assert found.overlap > 0.7
    assert np.sqrt(np.diag(found.covariance))[3:].min() >= SETTINGS.floor_translation


def test_another_place_is_none(maps):
    candidate = Candidate(0, 2, maps[0].T_map_base.between(maps[2].T_map_base))
    found = Verifier(maps, SETTINGS, ODOMETRY).verify(candidate, known(maps, 0, 2, LOOSE))
    assert found == 'no_overlap'


def test_what_contradicts_the_known_pose_is_none_however_well_it_fits(maps):
    far = Known(pose(40.0, 5.0, 178.0), TIGHT)
    candidate = by_place(maps[:2], SETTINGS)[0]
    assert not conceivable(candidate, far) and conceivable(candidate, known(maps, 0, 1, LOOSE))
    found = find_closures(maps[:2], lambda *_: far, SETTINGS, ODOMETRY, recognise=())
    assert found.closures == () and found.refused == {'improbable': 1} and found.tested == {}


def test_candidates_by_place_are_near_and_a_way_apart(maps):
    assert [(one.first, one.second) for one in by_place(maps, SETTINGS)] == [
        (0, 1),
        (1, 2),
        (0, 2),
    ]
    beside = [maps[0], replace(maps[1], travelled=59.0)]
    assert by_place(beside, SETTINGS) == []
    assert comparable(maps[0], replace(maps[1], travelled=0.0, run=1), SETTINGS)
    assert by_place(maps, SETTINGS.model_copy(update={'radius': 3.0})) != []  # 1 and 2 are one
    far = [maps[0], replace(maps[1], T_map_base=pose(26.0, 0.0))]
    assert by_place(far, SETTINGS) == []


def straight(count, travelled):
    """Local maps along a straight way that is driven twice."""
    there = [LocalMap(i, i, pose(20.0 * i, 0.0), 20.0 * i, np.zeros((0, 3))) for i in range(count)]
    return there + [
        LocalMap(count + i, count + i, pose(20.0 * i, 0.5), travelled + 20.0 * i, np.zeros((0, 3)))
        for i in range(count)
    ]


def closure(maps, first, second, off=0.0):
    true = maps[first].T_map_base.between(maps[second].T_map_base)
    return Closure(first, second, true.compose(pose(off, 0.0)), np.eye(6), 1.0)


def test_a_closure_that_contradicts_the_others_is_left_out():
    maps = straight(4, 1000.0)
    # All agree that the second pass is 2 m on, but for one.
    closures = [closure(maps, i, 4 + i, 2.0 + 12.0 * (i == 2)) for i in range(4)]
    held, contradicted, alone = consistent_set(closures, maps)
    assert held == [closures[0], closures[1], closures[3]]
    assert contradicted == [closures[2]] and alone == []


def test_a_closure_that_nothing_confirms_is_left_out():
    maps = straight(4, 1000.0)
    twice = [closure(maps, 0, 4), closure(maps, 1, 4)]
    held, contradicted, alone = consistent_set(twice, maps)
    assert (held, contradicted, alone) == ([], [], twice)  # one witness, seen twice
    held, _, alone = consistent_set([*twice, closure(maps, 1, 5)], maps)
    assert len(held) == 2 and len(alone) == 1


def test_no_more_pairs_are_registered_than_wanted_and_none_twice(maps):
    loose = known(maps, 0, 1, LOOSE)
    first = find_closures(maps, lambda *_: loose, SETTINGS, ODOMETRY, recognise=(), most=1)
    assert first.refused == {LEFT: 1, 'improbable': 1, 'alone': 1} and set(first.tested) == {(1, 2)}
    without = [replace(one, points=np.zeros((0, 3))) for one in maps]
    again = find_closures(
        without, lambda *_: loose, SETTINGS, ODOMETRY, recognise=(), tested=first.tested, most=0
    )
    assert again.refused == first.refused and again.tested == first.tested


def test_what_registration_finds_improbable_is_not_registered_again(maps):
    # Where it lies by its candidate it may be, where registration puts it not.
    tight = known(maps, 0, 1, 1e-4 * TIGHT)
    first = find_closures(maps[:2], lambda *_: tight, SETTINGS, ODOMETRY, recognise=())
    assert first.refused == {'improbable': 1} and isinstance(first.tested[1, 2], Closure)
    again = find_closures(
        maps[:2], lambda *_: tight, SETTINGS, ODOMETRY, recognise=(), tested=first.tested, most=0
    )
    assert again.refused == {'improbable': 1}
    # Where what is known is known by the closure itself, it is not asked.
    asked = []
    held = find_closures(
        maps[:2], lambda *pair: asked.append(pair), SETTINGS, ODOMETRY, recognise=(),
        tested=first.tested, closed={(1, 2)},
    )  # fmt: skip
    assert asked == [] and held.refused == {'alone': 1}


def beside(count):
    """A way of so many local maps, and the same way once more, 5 m aside."""
    nothing = np.zeros((0, 3), dtype=np.float32)
    there = [pose(20.0 * number, 0.0) for number in range(count)]
    again = [pose(20.0 * number + 8.0, 5.0) for number in range(count)]
    return [
        LocalMap(number, number, place, 20.0 * number + 1000.0 * (number >= count), nothing)
        for number, place in enumerate([*there, *again])
    ]


@pytest.mark.parametrize('loops', [False, True])
def test_what_nothing_could_confirm_is_not_registered(monkeypatch, loops):
    maps, looked = beside(30), []

    def verify(self, candidate, known, once):
        looked.append((candidate.first, candidate.second))
        if not loops:
            return 'no_overlap'
        return Closure(
            candidate.first, candidate.second, candidate.T_first_second, 1e-4 * np.eye(6), 1.0
        )

    monkeypatch.setattr(Verifier, 'verify', verify)
    pairs = [(pair.first, pair.second) for pair in by_place(maps, SETTINGS)]
    found = find_closures(maps, lambda *_: None, SETTINGS, ODOMETRY, recognise=(), once=True)
    assert found.candidates == len(pairs) > 55
    if loops:  # each of them is confirmed by others
        assert sorted(looked) == sorted(pairs) and len(found.closures) == len(pairs)
    else:
        # One for each local map, and for every second one after a long way without any.
        assert 24 <= len(looked) <= 26 and len({second for _, second in looked}) == len(looked)
        assert found.refused == {'no_overlap': len(looked), 'alone': len(pairs) - len(looked)}
    looked.clear()
    find_closures(maps, lambda *_: None, SETTINGS, ODOMETRY, recognise=())
    assert sorted(looked) == sorted(pairs)  # who goes on with what was tested has all of it


def test_a_loop_after_a_long_way_without_any_is_found_as_a_whole(monkeypatch):
    maps, looked = beside(60), []
    begin = 100  # of the local maps that show what was passed

    def verify(self, candidate, known, once):
        looked.append((candidate.first, candidate.second))
        if candidate.second < begin:
            return 'no_overlap'
        return Closure(
            candidate.first, candidate.second, candidate.T_first_second, 1e-4 * np.eye(6), 1.0
        )

    monkeypatch.setattr(Verifier, 'verify', verify)
    pairs = [(pair.first, pair.second) for pair in by_place(maps, SETTINGS)]
    found = find_closures(maps, lambda *_: None, SETTINGS, ODOMETRY, recognise=(), once=True)
    closed = {(one.first, one.second) for one in found.closures}
    assert closed == {pair for pair in pairs if pair[1] >= begin}
    assert len(looked) == len(set(looked)) < len(pairs) - 40
    assert found.candidates == len(pairs)


def test_what_is_improbable_is_not_registered_the_other_way_round(maps, monkeypatch):
    tight, targets = known(maps, 0, 1, 1e-4 * TIGHT), []
    align = verification._align
    monkeypatch.setattr(
        verification,
        '_align',
        lambda target, *rest, **more: (targets.append(id(target)), align(target, *rest, **more))[1],
    )
    verifier = Verifier(maps, SETTINGS, ODOMETRY)
    candidate = by_place(maps[:2], SETTINGS)[0]
    assert verifier.verify(candidate, tight, once=True) == 'improbable'
    assert len(set(targets)) == 1
    assert isinstance(verifier.verify(candidate, tight), Closure)
    assert len(set(targets)) == 2


def test_stretches_stay_while_poses_move_and_the_way_grows():
    placed = [PlacedCluster(i, i, Cluster((CoreMeasurement(i, 'top', CoreKind.LIDAR),)))
              for i in range(200)]  # fmt: skip

    def values(step):
        made = gtsam.Values()
        for number in range(200):
            made.insert(pose_key(number), pose(step * number, 0.0))
        return made

    whole = cut_way(placed, values(1.0), 20.0)
    assert [one.end for one in whole] == list(range(20, 201, 20))
    assert [one.middle for one in whole] == list(range(10, 200, 20))
    before = cut_way(placed[:130], values(1.0), 20.0)[:-1]
    assert before == whole[:6]
    grown = cut_way(placed, values(1.1), 20.0, before)
    assert grown[:6] == before and grown[6:] != whole[6:]
    assert [one.end for one in grown[6:]] == [139, 157, 175, 193, 200]
    assert cut_way(placed[:100], values(1.0), 20.0, whole[:5]) == whole[:5]


def test_closures_of_two_drives_are_found_as_those_of_one():
    shift = pose(2.0, 1.0, 2.0)
    places = [(pose(8.0 * i, 0.0), pose(8.0 * i, 4.0, 180.0)) for i in range(2)]
    maps = [seen(TOWN, first, i, None, 8.0 * i) for i, (first, _) in enumerate(places)]
    maps += [
        seen(TOWN, second, 2 + i, shift.compose(second), 20.0 - 8.0 * i, run=1)
        for i, (_, second) in enumerate(places)
    ]
    found = find_closures(maps, lambda *_: None, SETTINGS, ODOMETRY)
    assert found.candidates >= 4 and len(found.closures) >= 2
    for one in found.closures:
        assert (maps[one.first].run, maps[one.second].run) == (0, 1)
        true = places[one.first][0].between(places[one.second - 2][1])
        assert np.abs(gtsam.Pose3.Logmap(true.between(one.T_first_second))).max() < 0.05


def test_places_are_recognised_wherever_they_are_thought_to_lie():
    pytest.importorskip('map_closures', reason='the extra closures is not installed')
    rng = np.random.default_rng(5)
    parts = [np.column_stack([rng.uniform(-50.0, 50.0, (20_000, 2)), np.zeros(20_000)])]
    for x, y, turn, long in rng.uniform(
        (-45.0, -45.0, 0.0, 3.0), (45.0, 45.0, 3.0, 15.0), (150, 4)
    ):
        along = 0.5 * long * np.array([np.cos(turn), np.sin(turn)])
        parts.append(wall(rng, (x, y) - along, (x, y) + along, 6.0))
    points = np.vstack(parts)
    moved = pose(4.0, 6.0, 90.0)
    lost = [
        LocalMap(0, 0, pose(0.0, 0.0), 0.0, points),
        LocalMap(1, 1, pose(300.0, -80.0), 500.0, moved.transformTo(points.T).T),
    ]
    assert by_place(lost, SETTINGS) == []
    (found,) = by_looks(lost, SETTINGS)
    off = gtsam.Pose3.Logmap(moved.between(found.T_first_second))
    assert np.abs(off[3:5]).max() < 2.0 and abs(off[2]) < 0.05


def test_maps_that_share_a_strip_are_not_drawn_over_each_other():
    # As where one session ends and another begins: each has what lies to its side.
    first, second = pose(0.0, 0.0), pose(8.0, 0.5)
    one = seen(TOWN, first, 1)
    other = seen(TOWN, second, 2, second.compose(pose(0.35, -0.1)), run=1)
    sides = [
        replace(one, points=one.points[one.points[:, 0] < 7.0]),
        replace(other, points=other.points[other.points[:, 0] > -7.0]),
    ]
    fixes = known(sides, 0, 1, np.diag(np.square([0.01] * 3 + [0.2] * 3)))
    settings = SETTINGS.model_copy(update={'min_overlap': 0.0})
    candidate = Candidate(0, 1, fixes.T_first_second)
    found = Verifier(sides, settings, ODOMETRY).verify(candidate, fixes)
    off = gtsam.Pose3.Logmap(first.between(second).between(found.T_first_second))
    assert np.linalg.norm(off[3:5]) < 0.03
