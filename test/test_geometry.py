"""Rigid transforms: made of the numbers that people write, mended within rounding, else refused."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.geometry import nearest_rotation, pose_matrix, transform_points

seeds = st.integers(0, 10_000)


@given(seeds)
def test_seven_and_twelve_numbers_make_the_same_pose(seed):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng)
    shift = rng.normal(scale=10.0, size=3)
    made = pose_matrix([*shift, *turn.as_quat()])
    assert made[:3, :3] == pytest.approx(turn.as_matrix(), abs=1e-12)
    assert made[:3, 3].tolist() == shift.tolist()
    assert made[3].tolist() == [0, 0, 0, 1]
    assert pose_matrix(made[:3].ravel()) == pytest.approx(made, abs=1e-12)


def test_quaternion_is_scaled_to_length_one_where_it_nearly_has_it():
    turn = Rotation.from_euler('z', 0.3).as_quat()
    made = pose_matrix([0, 0, 0, *(turn * 1.0009)])
    assert made[:3, :3] == pytest.approx(Rotation.from_euler('z', 0.3).as_matrix(), abs=1e-12)
    with pytest.raises(ValueError, match=r'norm 1\.0011'):
        pose_matrix([0, 0, 0, *(turn * 1.0011)])


@pytest.mark.parametrize(
    ('numbers', 'words'),
    [
        ([0] * 6, '6 numbers; expected 7'),
        ([0, 0, 0, 0, 0, 0, np.nan], 'finite'),
        ([0, 0, 0, 0, 0, 0, 0], 'norm 0'),
        ([1, 0, 0, np.inf, 0, 1, 0, 0, 0, 0, 1, 0], 'finite'),
        ([2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0], 'no rotation: determinant 8'),
        ([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0], 'no rotation: determinant -1'),
    ],
)
def test_numbers_that_are_no_pose_are_refused(numbers, words):
    with pytest.raises(ValueError, match=words):
        pose_matrix(numbers)


@given(seeds, st.sampled_from([0.0, 1e-9, 1e-5, 2e-3]))
def test_nearest_rotation_is_the_one_of_gtsam(seed, error):
    rng = np.random.default_rng(seed)
    matrix = Rotation.random(rng=rng).as_matrix() + rng.uniform(-error, error, (3, 3))
    nearest = nearest_rotation(matrix)
    assert nearest == pytest.approx(gtsam.Rot3.ClosestTo(matrix).matrix(), abs=1e-9)
    assert nearest @ nearest.T == pytest.approx(np.eye(3), abs=1e-14)


def test_matrix_is_mended_up_to_the_tolerance_only():
    for factor, fits in ((1.0 + 4.9e-3, True), (1.0 + 5.1e-3, False)):  # M Mᵀ is off by twice that
        if fits:
            assert nearest_rotation(np.eye(3) * factor) == pytest.approx(np.eye(3), abs=1e-15)
        else:
            with pytest.raises(ValueError, match='no rotation'):
                nearest_rotation(np.eye(3) * factor)
    assert nearest_rotation(np.eye(3) * 1.2, tolerance=0.5) == pytest.approx(np.eye(3), abs=1e-15)
    with pytest.raises(ValueError, match='finite'):
        nearest_rotation(np.full((3, 3), np.nan))


@given(seeds)
def test_points_are_moved_as_gtsam_moves_them(seed):
    rng = np.random.default_rng(seed)
    pose = gtsam.Pose3.Expmap(rng.normal(size=6))
    points = rng.normal(scale=30.0, size=(20, 3))
    wanted = np.array([pose.transformFrom(point) for point in points])
    assert transform_points(pose.matrix(), points) == pytest.approx(wanted, abs=1e-9)
