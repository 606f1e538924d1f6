"""MOM: the fast score against the direct one, plane families, and what the score prefers."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from room_scene import (
    SETTINGS,
    jittered,
    lattice_room,
    make_scene,
    moved,
    pose,
    room_scene,
    score_by_brute_force,
    wall,
    with_candidates,
)

from incremental_mapper.config import MomSettings
from incremental_mapper.scoring import mom
from incremental_mapper.scoring.mom import (
    choose_query_points,
    direct_score,
    direct_variances,
    fast_score,
    fast_scores,
)
from incremental_mapper.scoring.neighbourhoods import BoundaryPairs


def without_search():
    """Inside the block, a fast score that searches again is an error."""
    return patch.object(mom, 'direct_variances', side_effect=AssertionError('searched again'))


@pytest.mark.parametrize('seed', range(3))
def test_fast_score_is_the_direct_one_at_the_reference_poses(seed):
    local_map = room_scene(seed)
    query_points = choose_query_points(local_map, SETTINGS)
    direct = direct_score(query_points, local_map.poses[0], local_map, SETTINGS)
    with without_search():
        fast = fast_score(query_points, local_map.poses[0], local_map, SETTINGS)
    assert fast == pytest.approx(direct, rel=1e-9)
    # The oracle works 300 m from zero and so loses three digits.
    assert fast == pytest.approx(
        score_by_brute_force(query_points, local_map.poses[0], local_map), rel=1e-6
    )


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 2),
    st.tuples(*[st.floats(-0.4, 0.4)] * 3),
    st.tuples(*[st.floats(-0.03, 0.03)] * 3),
)
def test_fast_score_is_the_direct_one_wherever_the_local_maps_candidates_are(which, shift, turn):
    # No point is more than 15 m from its scan's pose, so nothing drifts by more than the radius.
    assert np.linalg.norm(shift) + 15 * np.linalg.norm(turn) < SETTINGS.radius
    local_map = room_scene(1)
    poses = moved(local_map, shift, turn, which)
    local_map = with_candidates(local_map, poses)
    query_points = choose_query_points(local_map, SETTINGS)
    with without_search():
        fast = fast_score(query_points, poses, local_map, SETTINGS)
    assert fast == pytest.approx(direct_score(query_points, poses, local_map, SETTINGS), rel=1e-9)


@pytest.mark.parametrize(('metres', 'radians'), [(0.01, 5e-4), (0.05, 3e-3), (0.15, 1e-2)])
def test_scores_of_many_candidates_are_those_of_each(metres, radians):
    local_map = jittered(room_scene(2), mom.BATCH + 7, metres, radians)
    query_points = choose_query_points(local_map, SETTINGS)
    with without_search():
        fast = fast_scores(query_points, local_map.poses, local_map, SETTINGS)
        single = [fast_score(query_points, poses, local_map, SETTINGS) for poses in local_map.poses]
    direct = [direct_score(query_points, poses, local_map, SETTINGS) for poses in local_map.poses]
    assert len(set(fast.tolist())) == len(local_map.poses)
    assert fast == pytest.approx(single, rel=1e-12)
    assert fast == pytest.approx(direct, rel=1e-9)
    brute = score_by_brute_force(query_points, local_map.poses[5], local_map)
    assert fast[5] == pytest.approx(brute, rel=1e-6)


AXES = [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)]


@pytest.mark.parametrize('axis', AXES)
@pytest.mark.parametrize(('metres', 'searches'), [(0.3, 0), (SETTINGS.radius + 0.1, 1)])
def test_candidate_that_was_not_foreseen_has_its_true_score(axis, metres, searches):
    local_map = jittered(room_scene(1), 3, 0.02, 1e-3)
    query_points = choose_query_points(local_map, SETTINGS)
    stranger = moved(local_map, metres * np.array(axis))
    poses = np.stack([local_map.poses[1], stranger, local_map.poses[2]])
    with patch.object(mom, 'direct_variances', wraps=direct_variances) as search:
        fast = fast_scores(query_points, poses, local_map, SETTINGS)
    # Only what drifts by more than a neighbourhood is worth a search.
    assert search.call_count == searches
    direct = [direct_score(query_points, one, local_map, SETTINGS) for one in poses]
    assert fast == pytest.approx(direct, rel=1e-9)


def test_candidate_that_need_not_be_exact_is_never_searched_again():
    local_map = jittered(room_scene(1), 3, 0.02, 1e-3)
    query_points = choose_query_points(local_map, SETTINGS)
    stranger = moved(local_map, (0.3, 0.2, -0.1), (0.01, 0.0, 0.02))
    with without_search():
        found = fast_scores(query_points, stranger[None], local_map, SETTINGS, exact=False)
    direct = direct_score(query_points, stranger, local_map, SETTINGS)
    assert found[0] != pytest.approx(direct, rel=1e-9)
    assert found[0] == pytest.approx(direct, rel=0.5)


def test_candidate_that_is_far_off_does_not_widen_the_search_for_the_others():
    local_map = jittered(room_scene(1), 3, 0.02, 1e-3)
    lost = moved(local_map, (40.0, 0.0, 0.0))
    wide = with_candidates(local_map, *local_map.poses[1:], lost)
    query_points, alone = (
        choose_query_points(wide, SETTINGS),
        choose_query_points(local_map, SETTINGS),
    )
    assert len(query_points.boundary.inside) == len(alone.boundary.inside) > 0
    fast = fast_scores(query_points, wide.poses, wide, SETTINGS)
    direct = [direct_score(query_points, one, wide, SETTINGS) for one in wide.poses]
    assert fast == pytest.approx(direct, rel=1e-9)


def test_neighbours_that_come_or_go_change_the_score():
    # The boundary is looked at again: the moments of the reference alone would say otherwise.
    local_map = room_scene(1)
    poses = moved(local_map, (0.05, 0.05, 0.05))
    local_map = with_candidates(local_map, poses)
    query_points = choose_query_points(local_map, SETTINGS)
    boundary = BoundaryPairs(
        np.zeros_like(query_points.boundary.starts), np.zeros((0, 3)), np.zeros(0, dtype=bool)
    )
    bare = replace(query_points, boundary=boundary)
    exact = direct_score(query_points, poses, local_map, SETTINGS)
    frozen = fast_score(bare, poses, local_map, SETTINGS)
    assert frozen != pytest.approx(exact, rel=1e-6)
    assert frozen == pytest.approx(exact, rel=0.2)


@settings(deadline=None, max_examples=10)
@given(st.tuples(*[st.floats(-30, 30)] * 3), st.tuples(*[st.floats(-3, 3)] * 3))
def test_score_does_not_change_when_everything_moves_together(shift, turn):
    rng = np.random.default_rng(2)
    clouds = [lattice_room(rng) for _ in range(2)]
    local_map = make_scene(clouds, [pose((9, 9, 9), (0, 0, 0.4)), pose((8, 9, 9))])
    query_points = choose_query_points(local_map, SETTINGS)
    motion = pose(shift, turn) @ np.linalg.inv(pose())
    before = fast_score(query_points, local_map.poses[0], local_map, SETTINGS)
    poses = motion @ local_map.poses[0]
    assert fast_score(query_points, poses, local_map, SETTINGS) == pytest.approx(before, rel=1e-9)
    assert direct_score(query_points, poses, local_map, SETTINGS) == pytest.approx(before, rel=1e-9)


def test_few_planar_points_of_no_family_give_the_plane_variance():
    local_map = room_scene(7)
    strict = MomSettings(min_family_points=100_000)
    query_points = choose_query_points(local_map, strict)
    assert query_points.score_name == 'plane_variance'
    assert len(query_points.points) > 0
    aligned = fast_score(query_points, local_map.poses[0], local_map, SETTINGS)
    assert aligned < fast_score(
        query_points, moved(local_map, (0.2, 0.2, 0.2)), local_map, SETTINGS
    )


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('direction', [-1, 1])
def test_misaligned_scan_scores_worse_along_every_axis(axis, direction):
    local_map = room_scene(10)
    query_points = choose_query_points(local_map, SETTINGS)
    shift = np.zeros(3)
    aligned = fast_score(query_points, local_map.poses[0], local_map, SETTINGS)
    last = aligned
    for distance in (0.1, 0.2, 0.4):
        shift[axis] = direction * distance
        poses = moved(local_map, shift)
        score = fast_score(query_points, poses, local_map, SETTINGS)
        assert score > 1.5 * last
        assert direct_score(query_points, poses, local_map, SETTINGS) > aligned
        last = score


def test_score_is_the_noise_variance_of_aligned_walls():
    # The smallest eigenvalue of a well filled neighbourhood is the variance across the wall.
    local_map = room_scene(11)
    score = fast_score(
        choose_query_points(local_map, SETTINGS), local_map.poses[0], local_map, SETTINGS
    )
    assert score == pytest.approx(0.02**2, rel=0.15)


def test_every_family_has_the_same_weight_however_many_points_it_has():
    rng = np.random.default_rng(12)

    def cloud():
        floor = wall(rng, 2, count=3000, noise=0.01)
        return np.vstack([floor, wall(rng, 0, 700, 0.05), wall(rng, 1, 700, 0.01)])

    local_map = make_scene([cloud(), cloud()], [pose(), pose()])
    query_points = choose_query_points(local_map, SETTINGS)
    score = fast_score(query_points, local_map.poses[0], local_map, SETTINGS)
    assert query_points.score_name == 'mom_3'
    assert score == pytest.approx((0.01**2 + 0.05**2 + 0.01**2) / 3, rel=0.2)


def test_score_does_not_depend_on_where_the_map_is():
    local_map = room_scene(13)
    shift = np.array([5000.0, -3000.0, 100.0])
    poses = local_map.poses.copy()
    poses[:, :, :3, 3] += shift
    far = replace(
        local_map, fixed=local_map.fixed + shift, poses=poses, origin=local_map.origin + shift
    )
    near_score, far_score = (
        fast_score(choose_query_points(s, SETTINGS), s.poses[0], s, SETTINGS)
        for s in (local_map, far)
    )
    assert far_score == pytest.approx(near_score, rel=1e-6)


def test_candidate_that_is_no_number_does_not_reach_into_the_others():
    local_map = jittered(room_scene(1), 3, 0.02, 1e-3)
    nowhere = np.full_like(local_map.poses[:1], np.nan)
    query_points = choose_query_points(
        replace(local_map, poses=np.vstack([local_map.poses, nowhere])), SETTINGS
    )
    assert query_points.reach.tolist() == choose_query_points(local_map, SETTINGS).reach.tolist()
    alone = fast_scores(query_points, local_map.poses, local_map, SETTINGS).tolist()
    for exact in (False, True):
        poses = np.vstack([local_map.poses, nowhere])
        found = fast_scores(query_points, poses, local_map, SETTINGS, exact)
        assert found[:-1].tolist() == alone
        assert np.isnan(found[-1])
