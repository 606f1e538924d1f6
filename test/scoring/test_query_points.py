"""Where a local map is judged: planar, shared by scans, sorted by family."""

from dataclasses import replace

import numpy as np
import pytest
from room_scene import SETTINGS, jittered, make_scene, pose, room, room_scene, wall
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.scoring.mom import (
    LocalMap,
    choose_query_points,
    direct_score,
    fast_score,
)


def test_pairs_of_one_scan_are_never_boundary_pairs():
    local_map = jittered(room_scene(1), 5, 0.03, 1e-3)
    query_points = choose_query_points(local_map, SETTINGS)
    every = np.arange(len(query_points.points))
    assert len(query_points.boundary.inside) > 100
    starts = query_points.boundary.starts
    assert (starts[every, query_points.scan] == starts[every, query_points.scan + 1]).all()
    assert query_points.reach[every, query_points.scan].tolist() == [0.0] * len(every)
    alone = replace(local_map, poses=local_map.poses[:1])
    assert len(choose_query_points(alone, SETTINGS).boundary.inside) == 0


def test_query_points_do_not_depend_on_the_other_candidates():
    local_map = jittered(room_scene(3), 5, 0.05, 2e-3)
    many = choose_query_points(local_map, SETTINGS)
    one = choose_query_points(replace(local_map, poses=local_map.poses[:1]), SETTINGS)
    assert many.points.tolist() == one.points.tolist()
    assert many.family.tolist() == one.family.tolist()


@pytest.mark.parametrize(
    ('axes', 'name'),
    [((0, 1, 2), 'mom_3'), ((0, 1), 'mom_2'), ((1, 2), 'mom_2'), ((2,), 'mom_1')],
)
def test_each_direction_of_walls_is_a_family(axes, name):
    query_points = choose_query_points(room_scene(3, axes), SETTINGS)
    assert query_points.score_name == name
    assert len(query_points.families) == len(axes)


def test_families_do_not_care_how_the_room_is_turned():
    rng = np.random.default_rng(5)
    turn = Rotation.random(rng=rng).as_matrix()
    clouds = [room(rng) @ turn.T for _ in range(2)]
    query_points = choose_query_points(make_scene(clouds, [pose(), pose((1, 0, 0))]), SETTINGS)
    assert query_points.score_name == 'mom_3'
    counts = [int((query_points.family == family).sum()) for family in range(3)]
    assert max(counts) <= SETTINGS.max_points // 3
    assert min(counts) > SETTINGS.min_family_points


def test_family_with_too_few_points_does_not_count():
    rng = np.random.default_rng(6)
    clouds = [np.vstack([room(rng, (0, 2)), wall(rng, 1, count=12, size=1.0)]) for _ in range(2)]
    query_points = choose_query_points(make_scene(clouds, [pose(), pose()]), SETTINGS)
    assert query_points.score_name == 'mom_2'


def test_bush_has_no_query_point_and_no_score():
    rng = np.random.default_rng(8)
    clouds = [rng.uniform(0, 6, size=(2000, 3)) for _ in range(2)]
    local_map = make_scene(clouds, [pose(), pose((1, 0, 0))])
    query_points = choose_query_points(local_map, SETTINGS)
    assert query_points is None or query_points.score_name == 'plane_variance'
    assert choose_query_points(local_map, MomSettings(eigenvalue_ratio=100.0)) is None


def test_scan_that_shares_nothing_with_others_has_no_query_point():
    rng = np.random.default_rng(9)
    far = room(rng) + np.array([100.0, 0.0, 0.0])
    assert choose_query_points(make_scene([room(rng), far], [pose(), pose()]), SETTINGS) is None


def test_window_without_a_scan_has_no_query_point():
    fixed = room(np.random.default_rng(1))
    local_map = LocalMap(fixed, [], np.zeros((1, 0, 4, 4)), 0, np.zeros(3))
    assert choose_query_points(local_map, SETTINGS) is None


def test_point_that_is_no_number_has_no_neighbour():
    local_map = room_scene(1)
    bad = local_map.moving[0].copy()
    bad[1::50], bad[2::50, 1], bad[3::50, 2], bad[4::50] = np.nan, np.inf, -np.inf, 1e300
    broken = replace(local_map, moving=[bad, *local_map.moving[1:]])
    query_points = choose_query_points(broken, SETTINGS)
    kept = [bad[(np.abs(bad) < 1e9).all(axis=1)], *local_map.moving[1:]]
    assert np.isfinite(query_points.points).all()
    fast = fast_score(query_points, local_map.poses[0], broken, SETTINGS)
    direct = direct_score(
        query_points, local_map.poses[0], replace(local_map, moving=kept), SETTINGS
    )
    assert fast == pytest.approx(direct, rel=1e-9)
