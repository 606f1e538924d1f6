import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.trajectory_errors import (
    consecutive_pairs,
    pairs_apart,
    relative_pose_errors,
    trajectory_errors,
)
from incremental_mapper.trajectory import Trajectory, fit_rigid, from_matrices, match_truth

START = 1_544_590_798_123_456_789
SEEDS = st.integers(0, 2**32 - 1)


def random_transform(rng: np.random.Generator, reach: float) -> NDArray[np.float64]:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)).as_matrix()
    transform[:3, 3] = rng.uniform(-reach, reach, 3)
    return transform


def random_walk(rng: np.random.Generator, count: int, period_s: float = 0.1) -> Trajectory:
    """A drive whose poses come at uneven times, ``period_s`` apart on the average."""
    steps = rng.uniform(0.3, 1.7, count) * period_s * NANOSECONDS
    headings = np.cumsum(rng.normal(0.0, 0.1, count))
    turns = Rotation.from_euler('zyx', np.c_[headings, rng.normal(0.0, 0.02, (count, 2))])
    positions = np.cumsum(turns.apply([1.0, 0.0, 0.0]) * rng.uniform(0.0, 2.0, (count, 1)), axis=0)
    stamps = START + np.cumsum(steps.astype(np.int64))
    return Trajectory(stamps, positions, turns.as_quat())


def disturbed(rng: np.random.Generator, trajectory: Trajectory) -> Trajectory:
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.02, (len(trajectory), 3)))
    return Trajectory(
        trajectory.stamps,
        trajectory.positions + rng.normal(0.0, 0.1, (len(trajectory), 3)),
        (trajectory.rotations() * turns).as_quat(),
    )


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.integers(2, 60))
def test_no_error_for_the_truth_in_another_map_frame(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_walk(rng, count)
    moved = from_matrices(truth.stamps, random_transform(rng, 100.0) @ truth.matrices())

    errors = trajectory_errors(moved, truth)

    assert errors is not None
    assert errors.rpe_translation_rmse_m < 1e-9
    assert errors.rpe_rotation_rmse_deg < 1e-5
    assert errors.ate_rmse_m < 1e-9
    assert errors.pairs == count - 1
    assert errors.poses_without_truth == 0


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_errors_do_not_depend_on_the_map_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_walk(rng, 40)
    estimate = disturbed(rng, truth)
    moved = from_matrices(estimate.stamps, random_transform(rng, 50.0) @ estimate.matrices())

    here, there = trajectory_errors(estimate, truth), trajectory_errors(moved, truth)

    assert here is not None
    assert there is not None
    assert there.rpe_translation_rmse_m == pytest.approx(here.rpe_translation_rmse_m, abs=1e-9)
    assert there.rpe_rotation_rmse_deg == pytest.approx(here.rpe_rotation_rmse_deg, abs=1e-6)
    assert there.ate_rmse_m == pytest.approx(here.ate_rmse_m, abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.integers(1, 30))
def test_the_rigid_fit_finds_the_transform(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    transform = random_transform(rng, 1000.0)
    points = rng.normal(0.0, 10.0, (count, 3))
    targets = points @ transform[:3, :3].T + transform[:3, 3]

    fitted = fit_rigid(points, targets)

    assert np.linalg.det(fitted[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(points @ fitted[:3, :3].T + fitted[:3, 3], targets, atol=1e-8)


def test_a_mirror_image_is_fitted_by_a_rotation() -> None:
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]])

    fitted = fit_rigid(points, points * [1.0, 1.0, -1.0])

    assert np.linalg.det(fitted[:3, :3]) == pytest.approx(1.0)


def test_a_straight_drive_is_aligned() -> None:
    """The rotation about the line of travel is open; the fit must stay a rotation."""
    points = np.c_[np.arange(10.0), np.zeros((10, 2))]

    fitted = fit_rigid(points, points[:, [1, 0, 2]])

    assert np.linalg.det(fitted[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(
        points @ fitted[:3, :3].T + fitted[:3, 3], points[:, [1, 0, 2]], atol=1e-9
    )


def test_known_errors() -> None:
    """Each step is 0.1 m too long and 1 degree too far to the left."""
    stamps = START + np.arange(3, dtype=np.int64) * NANOSECONDS
    truth = Trajectory(
        stamps,
        np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]),
        np.tile([0.0, 0.0, 0.0, 1.0], (3, 1)),
    )
    step = np.eye(4)
    step[:3, :3] = Rotation.from_euler('z', 1.0, degrees=True).as_matrix()
    step[0, 3] = 1.1
    estimate = from_matrices(stamps, np.stack([np.eye(4), step, step @ step]))

    errors = trajectory_errors(estimate, truth)

    assert errors is not None
    assert errors.rpe_translation_rmse_m == pytest.approx(0.1)
    assert errors.rpe_rotation_rmse_deg == pytest.approx(1.0)
    assert errors.rpe_per_second_translation_rmse_m == pytest.approx(0.1)
    assert errors.rpe_per_second_rotation_rmse_deg == pytest.approx(1.0)


def test_truth_is_interpolated_and_uncovered_poses_are_counted() -> None:
    truth = Trajectory(
        np.array([START, START + 10 * NANOSECONDS]),
        np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]]),
        np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
    )
    seconds = np.array([-1, 0, 3, 10, 11], dtype=np.int64)
    positions = np.c_[seconds.astype(float), np.zeros((5, 2))]
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (5, 1))
    estimate = Trajectory(START + seconds * NANOSECONDS, positions, quaternions)

    errors = trajectory_errors(estimate, truth)

    assert errors is not None
    assert errors.poses_without_truth == 2
    assert errors.pairs == 2
    assert errors.rpe_translation_rmse_m == pytest.approx(0.0, abs=1e-9)
    assert errors.rpe_per_second_translation_rmse_m is None


@pytest.mark.parametrize('count', [0, 1])
def test_too_few_poses_have_no_errors(count: int) -> None:
    truth = random_walk(np.random.default_rng(1), 20)
    few = Trajectory(truth.stamps[:count], truth.positions[:count], truth.quaternions[:count])

    assert trajectory_errors(few, truth) is None


def test_no_truth_has_no_errors() -> None:
    estimate = random_walk(np.random.default_rng(1), 20)
    nothing = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 4)))

    assert trajectory_errors(estimate, nothing) is None


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(1, 2 * NANOSECONDS), max_size=60), st.integers(1, 3 * NANOSECONDS))
def test_partners_are_the_nearest_poses(gaps: list[int], span: int) -> None:
    stamps = START + np.cumsum(np.array(gaps, dtype=np.int64))

    pairs = pairs_apart(stamps, span)

    partner = dict(pairs.tolist())
    for index, stamp in enumerate(stamps.tolist()):
        off = np.abs(stamps - stamp - span)
        later = off[index + 1 :]
        if len(later) and later.min() <= span // 2 and later.min() <= off[index]:
            assert off[partner[index]] == off.min()
        elif index in partner:
            pytest.fail(f'pose {index} has no pose near {span} ns later, yet a partner')


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_equal_to_evo(seed: int) -> None:
    reason = 'evo is not installed; it is the independent implementation compared with'
    metrics = pytest.importorskip('evo.core.metrics', reason=reason)
    evo_trajectory = pytest.importorskip('evo.core.trajectory', reason=reason)
    rng = np.random.default_rng(seed)
    truth = random_walk(rng, 80)
    estimate = disturbed(rng, truth)
    covered, reference = match_truth(estimate, truth)
    paths = [
        evo_trajectory.PosePath3D(poses_se3=list(path.matrices())) for path in (reference, covered)
    ]

    errors = trajectory_errors(estimate, truth)
    metres, degrees = relative_pose_errors(covered, reference, consecutive_pairs(covered.stamps))

    relations = metrics.PoseRelation
    for relation, own in (
        (relations.translation_part, metres),
        (relations.rotation_angle_deg, degrees),
    ):
        rpe = metrics.RPE(relation, delta=1, delta_unit=metrics.Unit.frames, all_pairs=False)
        rpe.process_data(tuple(paths))
        np.testing.assert_allclose(own, rpe.error, rtol=0.0, atol=1e-9)
    paths[1].align(paths[0])
    ape = metrics.APE(relations.translation_part)
    ape.process_data(tuple(paths))
    assert errors is not None
    assert errors.ate_rmse_m == pytest.approx(
        ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-9
    )
    assert errors.rpe_translation_rmse_m == pytest.approx(np.sqrt(np.mean(metres**2)), abs=1e-12)
