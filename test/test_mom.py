"""MOM: the fast score against the direct one, plane families, and what the score prefers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.criteria.mom import Scene, choose_judges, direct_score, fast_score
from incremental_mapper.criteria.planes import (
    covariances,
    orthogonal_families,
    smallest_eigenvalues,
    spread_positions,
)

SETTINGS = MomSettings()
ORIGIN = np.array([300.0, -200.0, 20.0])
MARGIN = 0.3


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


def make_scene(clouds, poses, fresh=1, fixed=None, margin=MARGIN):
    """Scans given in the room's frame, seen from their poses; the room stands at ORIGIN."""
    moving = [
        (cloud + ORIGIN - matrix[:3, 3]) @ matrix[:3, :3]
        for cloud, matrix in zip(clouds, poses, strict=True)
    ]
    settled = np.zeros((0, 3)) if fixed is None else fixed + ORIGIN
    return Scene(settled, moving, np.array(poses), margin, fresh, ORIGIN)


@cache
def room_scene(seed=0, axes=(0, 1, 2)):
    rng = np.random.default_rng(seed)
    poses = [pose((4, 5, 1), (0.02, -0.01, 0.6)), pose((3.5, 5, 1), (0, 0, 0.5)), pose((3, 5, 1))]
    return make_scene([room(rng, axes) for _ in poses], poses, 2, room(rng, axes))


def moved(scene, translation=(0, 0, 0), rotation=(0, 0, 0), which=0):
    """The scene's poses with one scan shifted and turned a little in the map."""
    poses = scene.reference.copy()
    poses[which, :3, :3] = Rotation.from_rotvec(rotation).as_matrix() @ poses[which, :3, :3]
    poses[which, :3, 3] += translation
    return poses


@pytest.mark.parametrize('seed', range(3))
def test_fast_score_is_the_direct_one_at_the_reference_poses(seed):
    scene = room_scene(seed)
    judges = choose_judges(scene, SETTINGS)
    direct = direct_score(judges, scene.reference, scene, SETTINGS)
    assert fast_score(judges, scene.reference, scene, SETTINGS) == pytest.approx(direct, rel=1e-9)


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 2),
    st.tuples(*[st.floats(-0.05, 0.05)] * 3),
    st.tuples(*[st.floats(-5e-3, 5e-3)] * 3),
)
def test_fast_score_is_the_direct_one_as_long_as_nothing_moves_beyond_the_margin(
    which, shift, turn
):
    # No point is more than 15 m from its scan's pose.
    assert np.linalg.norm(shift) + 15 * np.linalg.norm(turn) < MARGIN
    scene = room_scene(1)
    judges = choose_judges(scene, SETTINGS)
    poses = moved(scene, shift, turn, which)
    direct = direct_score(judges, poses, scene, SETTINGS)
    assert fast_score(judges, poses, scene, SETTINGS) == pytest.approx(direct, rel=1e-9)


def test_neighbours_that_come_or_go_change_the_score():
    # The shell is looked at again: the moments of the reference alone would say otherwise.
    scene = room_scene(1)
    wide, narrow = scene, replace(scene, margin=0.0)
    poses = moved(scene, (0.05, 0.05, 0.05))
    exact = direct_score(choose_judges(wide, SETTINGS), poses, wide, SETTINGS)
    frozen = fast_score(choose_judges(narrow, SETTINGS), poses, narrow, SETTINGS)
    assert frozen != pytest.approx(exact, rel=1e-6)
    assert frozen == pytest.approx(exact, rel=0.2)


@settings(deadline=None, max_examples=10)
@given(st.tuples(*[st.floats(-30, 30)] * 3), st.tuples(*[st.floats(-3, 3)] * 3))
def test_score_does_not_change_when_everything_moves_together(shift, turn):
    rng = np.random.default_rng(2)
    clouds = [lattice_room(rng) for _ in range(2)]
    scene = make_scene(clouds, [pose((9, 9, 9), (0, 0, 0.4)), pose((8, 9, 9))])
    judges = choose_judges(scene, SETTINGS)
    motion = pose(shift, turn) @ np.linalg.inv(pose())
    before = fast_score(judges, scene.reference, scene, SETTINGS)
    poses = motion @ scene.reference
    assert fast_score(judges, poses, scene, SETTINGS) == pytest.approx(before, rel=1e-9)
    assert direct_score(judges, poses, scene, SETTINGS) == pytest.approx(before, rel=1e-9)


def test_fast_score_follows_the_direct_one_for_larger_moves():
    scene = room_scene(2)
    judges = choose_judges(scene, SETTINGS)
    rng = np.random.default_rng(0)
    both = []
    for _ in range(15):
        poses = moved(scene, rng.normal(scale=0.1, size=3), rng.normal(scale=0.01, size=3))
        fast = fast_score(judges, poses, scene, SETTINGS)
        both.append((fast, direct_score(judges, poses, scene, SETTINGS)))
    ranks = np.argsort(np.argsort(np.array(both), axis=0), axis=0)
    assert np.corrcoef(ranks.T)[0, 1] > 0.95
    assert ranks[:, 0].argmin() == ranks[:, 1].argmin()


@pytest.mark.parametrize(
    ('axes', 'name'),
    [((0, 1, 2), 'mom_3'), ((0, 1), 'mom_2'), ((1, 2), 'mom_2'), ((2,), 'mom_1')],
)
def test_each_direction_of_walls_is_a_family(axes, name):
    judges = choose_judges(room_scene(3, axes), SETTINGS)
    assert judges.score_name == name
    assert len(judges.families) == len(axes)


def test_families_do_not_care_how_the_room_is_turned():
    rng = np.random.default_rng(5)
    turn = Rotation.random(rng=rng).as_matrix()
    clouds = [room(rng) @ turn.T for _ in range(2)]
    judges = choose_judges(make_scene(clouds, [pose(), pose((1, 0, 0))]), SETTINGS)
    assert judges.score_name == 'mom_3'
    counts = [int((judges.family == family).sum()) for family in range(3)]
    assert max(counts) <= SETTINGS.max_points // 3
    assert min(counts) > SETTINGS.min_family_points


def test_family_with_too_few_points_does_not_count():
    rng = np.random.default_rng(6)
    clouds = [np.vstack([room(rng, (0, 2)), wall(rng, 1, count=12, size=1.0)]) for _ in range(2)]
    judges = choose_judges(make_scene(clouds, [pose(), pose()]), SETTINGS)
    assert judges.score_name == 'mom_2'


def test_few_planar_points_of_no_family_give_the_plane_variance():
    scene = room_scene(7)
    strict = MomSettings(min_family_points=100_000)
    judges = choose_judges(scene, strict)
    assert judges.score_name == 'plane_variance'
    assert len(judges.points) > 0
    aligned = fast_score(judges, scene.reference, scene, SETTINGS)
    assert aligned < fast_score(judges, moved(scene, (0.2, 0.2, 0.2)), scene, SETTINGS)


def test_bush_has_no_judge_and_no_score():
    rng = np.random.default_rng(8)
    clouds = [rng.uniform(0, 6, size=(2000, 3)) for _ in range(2)]
    scene = make_scene(clouds, [pose(), pose((1, 0, 0))])
    judges = choose_judges(scene, SETTINGS)
    assert judges is None or judges.score_name == 'plane_variance'
    assert choose_judges(scene, MomSettings(eigenvalue_ratio=100.0)) is None


def test_scan_that_shares_nothing_with_others_has_no_judge():
    rng = np.random.default_rng(9)
    far = room(rng) + np.array([100.0, 0.0, 0.0])
    assert choose_judges(make_scene([room(rng), far], [pose(), pose()]), SETTINGS) is None


def test_window_without_a_scan_has_no_judge():
    fixed = room(np.random.default_rng(1))
    scene = Scene(fixed, [], np.zeros((0, 4, 4)), MARGIN, 0, np.zeros(3))
    assert choose_judges(scene, SETTINGS) is None


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize('direction', [-1, 1])
def test_misaligned_scan_scores_worse_along_every_axis(axis, direction):
    scene = room_scene(10)
    judges = choose_judges(scene, SETTINGS)
    shift = np.zeros(3)
    aligned = fast_score(judges, scene.reference, scene, SETTINGS)
    last = aligned
    for distance in (0.1, 0.2, 0.4):
        shift[axis] = direction * distance
        poses = moved(scene, shift)
        score = fast_score(judges, poses, scene, SETTINGS)
        assert score > 1.5 * last
        assert direct_score(judges, poses, scene, SETTINGS) > aligned
        last = score


def test_score_is_the_noise_variance_of_aligned_walls():
    # The smallest eigenvalue of a well filled neighbourhood is the variance across the wall.
    scene = room_scene(11)
    score = fast_score(choose_judges(scene, SETTINGS), scene.reference, scene, SETTINGS)
    assert score == pytest.approx(0.02**2, rel=0.15)


def test_every_family_has_the_same_weight_however_many_points_it_has():
    rng = np.random.default_rng(12)

    def cloud():
        floor = wall(rng, 2, count=3000, noise=0.01)
        return np.vstack([floor, wall(rng, 0, 700, 0.05), wall(rng, 1, 700, 0.01)])

    scene = make_scene([cloud(), cloud()], [pose(), pose()])
    judges = choose_judges(scene, SETTINGS)
    score = fast_score(judges, scene.reference, scene, SETTINGS)
    assert judges.score_name == 'mom_3'
    assert score == pytest.approx((0.01**2 + 0.05**2 + 0.01**2) / 3, rel=0.2)


def test_score_does_not_depend_on_where_the_map_is():
    scene = room_scene(13)
    shift = np.array([5000.0, -3000.0, 100.0])
    poses = scene.reference.copy()
    poses[:, :3, 3] += shift
    far = replace(scene, fixed=scene.fixed + shift, reference=poses, origin=scene.origin + shift)
    near_score, far_score = (
        fast_score(choose_judges(s, SETTINGS), s.reference, s, SETTINGS) for s in (scene, far)
    )
    assert far_score == pytest.approx(near_score, rel=1e-6)


values = st.lists(st.floats(0, 100), min_size=3, max_size=3)


@given(values, st.integers(0, 10_000))
def test_smallest_eigenvalue_is_that_of_the_matrix_made_of_it(eigenvalues, seed):
    turn = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    matrix = turn @ np.diag(eigenvalues) @ turn.T
    matrix = (matrix + matrix.T) / 2
    found = smallest_eigenvalues(matrix[None])
    assert found.shape == (1,)
    assert found[0] == pytest.approx(min(eigenvalues), abs=1e-9 * max(*eigenvalues, 1e-3))
    numpys = np.linalg.eigvalsh(matrix)[0]
    assert found[0] == pytest.approx(max(numpys, 0.0), abs=1e-9 * max(*eigenvalues, 1e-3))


@pytest.mark.parametrize(
    'matrix',
    [
        np.zeros((3, 3)),
        np.eye(3),
        np.ones((3, 3)),
        np.diag([1.0, 1.0, 0.0]),
        np.diag([-1e-18, 1, 1]),
    ],
)
def test_smallest_eigenvalue_of_a_degenerate_matrix_is_never_below_zero(matrix):
    found = smallest_eigenvalues(np.stack([matrix, np.diag([3.0, 2.0, 1.0])]))
    expected = max(np.linalg.eigvalsh(matrix)[0], 0.0)
    assert found == pytest.approx([expected, 1.0], abs=1e-12)
    assert (found >= 0).all()


@given(st.integers(1, 30), st.integers(0, 1000))
def test_covariance_of_moments_is_that_of_the_points(count, seed):
    points = np.random.default_rng(seed).normal(size=(count, 3)) + np.array([5.0, -3.0, 1.0])
    tilde = np.append(points, np.ones((count, 1)), axis=1)
    found = covariances((tilde.T @ tilde)[None])[0]
    assert found == pytest.approx(np.cov(points.T, bias=True).reshape(3, 3), abs=1e-12)


def test_covariance_of_no_point_is_zero():
    assert covariances(np.zeros((1, 4, 4))).tolist() == np.zeros((1, 3, 3)).tolist()


@settings(deadline=None)
@given(st.integers(0, 10_000), st.tuples(*[st.integers(5, 60)] * 3))
def test_normals_of_three_orthogonal_walls_are_sorted_into_three_families(seed, counts):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    truth = np.repeat(np.arange(3), counts)
    normals = turn.T[truth] * rng.choice([-1, 1], size=(len(truth), 1))
    found = orthogonal_families(normals, 0.2)
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    for wall_number in range(3):
        labels = set(found.labels[truth == wall_number].tolist())
        assert len(labels) == 1
        assert -1 not in labels
    assert len(set(found.labels.tolist())) == 3


def test_slanted_normals_belong_to_no_family():
    slanted = np.ones((4, 3)) / np.sqrt(3)
    normals = np.vstack([np.repeat(np.eye(3), 20, axis=0), slanted])
    found = orthogonal_families(normals, 0.2)
    assert found.labels[60:].tolist() == [-1] * 4
    assert (found.labels[:60] >= 0).all()


def test_no_normal_makes_no_label():
    assert len(orthogonal_families(np.zeros((0, 3)), 0.2).labels) == 0


@given(st.integers(0, 500), st.integers(1, 100))
def test_spread_positions_are_distinct_and_within_reach(count, wanted):
    positions = spread_positions(count, wanted)
    assert len(positions) == min(count, wanted) == len(set(positions.tolist()))
    assert all(0 <= p < count for p in positions)
