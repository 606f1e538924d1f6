"""MOM: the fast score against the direct one, plane families, and what the score prefers."""

from dataclasses import replace
from functools import cache
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.scoring import mom
from incremental_mapper.scoring.mom import (
    LocalMap,
    choose_query_points,
    direct_score,
    fast_score,
    fast_scores,
)
from incremental_mapper.scoring.neighbourhoods import BoundaryPairs
from incremental_mapper.scoring.plane_families import (
    MAX_AXES,
    orthogonal_families,
    spread_positions,
)
from incremental_mapper.scoring.strategies import Mom, Proposal, score_all

SETTINGS = MomSettings()
ORIGIN = np.array([300.0, -200.0, 20.0])


def wall(rng, axis, count=900, noise=0.02, size=10.0):
    """Points on a plane across ``axis`` that ends well before it meets the other planes."""
    points = rng.uniform(3.0, 3.0 + size, size=(count, 3))
    points[:, axis] = rng.normal(scale=noise, size=count)
    return points


def room(rng, axes=(0, 1, 2)):
    return np.vstack([wall(rng, axis) for axis in axes])


def lattice_room(rng):
    """Walls with points every 0.4 m, uneven by up to 2 cm.

    Within a wall no two points are 1.45 to 1.59 m apart, so that neighbourhoods of 1.5 m do not
    change when scans are moved by a few centimetres.
    """
    steps = 3.0 + 0.4 * np.arange(26)
    walls = []
    for axis in range(3):
        one, other = (grid.ravel() for grid in np.meshgrid(steps, steps))
        across = rng.uniform(-0.02, 0.02, size=len(one))
        walls.append(np.roll(np.stack([across, one, other], axis=1), axis, axis=1))
    return np.vstack(walls)


def pose(translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    matrix[:3, 3] = np.asarray(translation) + ORIGIN
    return matrix


def make_scene(clouds, poses, fresh=1, fixed=None):
    """Scans given in the room's frame, seen from their poses; the room stands at ORIGIN."""
    moving = [
        (cloud + ORIGIN - matrix[:3, 3]) @ matrix[:3, :3]
        for cloud, matrix in zip(clouds, poses, strict=True)
    ]
    settled = np.zeros((0, 3)) if fixed is None else fixed + ORIGIN
    return LocalMap(settled, moving, np.array(poses)[None], fresh, ORIGIN)


@cache
def room_scene(seed=0, axes=(0, 1, 2)):
    rng = np.random.default_rng(seed)
    poses = [pose((4, 5, 1), (0.02, -0.01, 0.6)), pose((3.5, 5, 1), (0, 0, 0.5)), pose((3, 5, 1))]
    return make_scene([room(rng, axes) for _ in poses], poses, 2, room(rng, axes))


def moved(local_map, translation=(0, 0, 0), rotation=(0, 0, 0), which=0):
    """The local_map's poses with one scan shifted and turned a little in the map."""
    poses = local_map.poses[0].copy()
    poses[which, :3, :3] = Rotation.from_rotvec(rotation).as_matrix() @ poses[which, :3, :3]
    poses[which, :3, 3] += translation
    return poses


def with_candidates(local_map, *candidates):
    return replace(local_map, poses=np.stack([local_map.poses[0], *candidates]))


def jittered(local_map, count, metres, radians, seed=0):
    """The local_map with candidates that move all of its scans at random."""
    rng = np.random.default_rng(seed)
    candidates = []
    for _ in range(count):
        poses = local_map.poses[0].copy()
        for one in poses:
            turn = Rotation.from_rotvec(rng.normal(scale=radians, size=3)).as_matrix()
            one[:3, :3] = turn @ one[:3, :3]
            one[:3, 3] += rng.normal(scale=metres, size=3)
        candidates.append(poses)
    return with_candidates(local_map, *candidates)


def without_search():
    """Inside the block, a fast score that searches again is an error."""
    return patch.object(mom, 'direct_score', side_effect=AssertionError('searched again'))


def score_by_brute_force(query_points, poses, local_map):
    """The definition, written without anything of the package but where the query_points are."""
    clouds = [local_map.fixed]
    motions = [np.eye(4)]
    for before, after, cloud in zip(local_map.poses[0], poses, local_map.moving, strict=True):
        clouds.append(cloud @ after[:3, :3].T + after[:3, 3])
        motions.append(after @ np.linalg.inv(before))
    points = np.vstack(clouds)
    variances = []
    for point, scan in zip(query_points.points, query_points.scan, strict=True):
        place = (motions[scan] @ np.append(point + local_map.origin, 1.0))[:3]
        near = points[np.linalg.norm(points - place, axis=1) <= SETTINGS.radius]
        variances.append(np.linalg.eigvalsh(np.cov(near.T, bias=True))[0])
    variances = np.array(variances)
    return np.mean(
        [variances[query_points.family == family].mean() for family in query_points.families]
    )


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
def test_fast_score_is_the_direct_one_wherever_the_scenes_candidates_are(which, shift, turn):
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
def test_candidate_that_the_judges_were_not_made_for_has_its_true_score(axis, metres, searches):
    local_map = jittered(room_scene(1), 3, 0.02, 1e-3)
    query_points = choose_query_points(local_map, SETTINGS)
    stranger = moved(local_map, metres * np.array(axis))
    poses = np.stack([local_map.poses[1], stranger, local_map.poses[2]])
    with patch.object(mom, 'direct_score', wraps=direct_score) as search:
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


def test_pairs_of_one_scan_are_never_in_the_rim():
    local_map = jittered(room_scene(1), 5, 0.03, 1e-3)
    query_points = choose_query_points(local_map, SETTINGS)
    every = np.arange(len(query_points.points))
    assert len(query_points.boundary.inside) > 100
    starts = query_points.boundary.starts
    assert (starts[every, query_points.scan] == starts[every, query_points.scan + 1]).all()
    assert query_points.reach[every, query_points.scan].tolist() == [0.0] * len(every)
    alone = replace(local_map, poses=local_map.poses[:1])
    assert len(choose_query_points(alone, SETTINGS).boundary.inside) == 0


def test_judges_do_not_depend_on_the_other_candidates():
    local_map = jittered(room_scene(3), 5, 0.05, 2e-3)
    many = choose_query_points(local_map, SETTINGS)
    one = choose_query_points(replace(local_map, poses=local_map.poses[:1]), SETTINGS)
    assert many.points.tolist() == one.points.tolist()
    assert many.family.tolist() == one.family.tolist()


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


def test_bush_has_no_judge_and_no_score():
    rng = np.random.default_rng(8)
    clouds = [rng.uniform(0, 6, size=(2000, 3)) for _ in range(2)]
    local_map = make_scene(clouds, [pose(), pose((1, 0, 0))])
    query_points = choose_query_points(local_map, SETTINGS)
    assert query_points is None or query_points.score_name == 'plane_variance'
    assert choose_query_points(local_map, MomSettings(eigenvalue_ratio=100.0)) is None


def test_scan_that_shares_nothing_with_others_has_no_judge():
    rng = np.random.default_rng(9)
    far = room(rng) + np.array([100.0, 0.0, 0.0])
    assert choose_query_points(make_scene([room(rng), far], [pose(), pose()]), SETTINGS) is None


def test_window_without_a_scan_has_no_judge():
    fixed = room(np.random.default_rng(1))
    local_map = LocalMap(fixed, [], np.zeros((1, 0, 4, 4)), 0, np.zeros(3))
    assert choose_query_points(local_map, SETTINGS) is None


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


@settings(deadline=None)
@given(st.integers(0, 10_000), st.tuples(*[st.integers(5, 60)] * 3))
def test_normals_of_three_orthogonal_walls_are_sorted_into_three_families(seed, counts):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    truth = np.repeat(np.arange(3), counts)
    normals = turn.T[truth] * rng.choice([-1, 1], size=(len(truth), 1))
    found = orthogonal_families(normals.T, 0.2)
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    for wall_number in range(3):
        labels = set(found.labels[truth == wall_number].tolist())
        assert len(labels) == 1
        assert -1 not in labels
    assert len(set(found.labels.tolist())) == 3


def test_slanted_normals_belong_to_no_family():
    slanted = np.ones((4, 3)) / np.sqrt(3)
    normals = np.vstack([np.repeat(np.eye(3), 20, axis=0), slanted])
    found = orthogonal_families(normals.T, 0.2)
    assert found.labels[60:].tolist() == [-1] * 4
    assert (found.labels[:60] >= 0).all()


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 150), st.floats(0.05, 1.2), st.integers(0, 10_000))
def test_axes_have_the_most_votes_that_any_have(count, angle, seed):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    normals[::3] = np.eye(3)[seed % 3] + 0.1 * normals[::3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found, limit = orthogonal_families(normals.T, angle), np.cos(angle)

    def alike(axes):
        return np.abs(axes @ normals.T) > limit

    trial = normals[spread_positions(count, MAX_AXES)]
    near = alike(trial)[alike(trial).sum(axis=1).argmax()]
    mean = np.linalg.eigh(normals[near].T @ normals[near])[1][:, -1]
    assert abs(mean @ found.axes[0]) == pytest.approx(1.0, abs=1e-9)
    across = trial - np.outer(trial @ mean, mean)
    across = across[np.linalg.norm(across, axis=1) > limit]
    if len(across):
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        votes = alike(across).sum(axis=1) + alike(np.cross(mean, across)).sum(axis=1)
        assert alike(found.axes[1:]).sum() == votes.max()
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    best = np.abs(found.axes @ normals.T)
    assert found.labels.tolist() == np.where(best.max(0) > limit, best.argmax(0), -1).tolist()


def test_no_normal_makes_no_label():
    assert len(orthogonal_families(np.zeros((3, 0)), 0.2).labels) == 0


@given(st.integers(0, 500), st.integers(1, 100))
def test_spread_positions_are_distinct_and_within_reach(count, wanted):
    positions = spread_positions(count, wanted)
    assert len(positions) == min(count, wanted) == len(set(positions.tolist()))
    assert all(0 <= p < count for p in positions)


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


@cache
def mom_criterion(direct):
    local_map = jittered(room_scene(4), 6, 0.05, 2e-3)
    return Mom(local_map, SETTINGS, choose_query_points(local_map, SETTINGS), direct)


@pytest.mark.parametrize('direct', [False, True])
def test_batch_of_proposals_scores_as_each_does(direct):
    criterion = mom_criterion(direct)
    proposals = [Proposal(None, poses=poses) for poses in criterion.local_map.poses]
    together = score_all(criterion, proposals)
    assert together == pytest.approx([criterion.score(one) for one in proposals], rel=1e-12)
    assert together == pytest.approx(score_all(mom_criterion(not direct), proposals), rel=1e-9)
    assert all(type(score) is float for score in together)
    assert score_all(criterion, []) == []


def test_criterion_of_a_user_is_asked_one_by_one():
    class Worst:
        name = 'worst'

        def score(self, proposal):
            return -proposal.solver_error

    proposals = [Proposal(None, solver_error=error) for error in (1.0, 3.0, 2.0)]
    assert score_all(Worst(), proposals) == [-1.0, -3.0, -2.0]
