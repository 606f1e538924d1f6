"""Where the car probably is: carried by the IMU or straight on, and always a rigid pose."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import ImuSettings
from incremental_mapper.frontend.dead_reckoning import (
    State,
    Turns,
    predict,
    propagate,
    turns_of,
)
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    ImuSeries,
    preintegration_parameters,
)
from incremental_mapper.frontend.prepared_scan import PreparedScan

MS = 1_000_000
PARAMETERS = preintegration_parameters(ImuSettings(), np.eye(4))
MAX_GAP = 100 * MS
UP = np.array([0.0, 0.0, 9.81])


def series(stamps, force):
    stamps = np.array(stamps, dtype=np.int64)
    return ImuSeries(stamps, np.zeros((len(stamps), 3)), np.tile(force, (len(stamps), 1)))


def standing(stamp=0, velocity=(0.0, 0.0, 0.0)):
    return State(stamp, gtsam.Pose3(), np.array(velocity), gtsam.imuBias.ConstantBias())


def moved(state, stamp, samples):
    return propagate(state, stamp, samples, PARAMETERS, MAX_GAP)


def test_a_state_is_carried_by_the_samples_between():
    pushed = moved(standing(), 100 * MS, series(range(0, 100 * MS, 10 * MS), UP + [2.0, 0.0, 0.0]))
    assert pushed.velocity == pytest.approx([0.2, 0.0, 0.0], abs=1e-9)
    assert pushed.pose.translation() == pytest.approx([0.01, 0.0, 0.0], abs=1e-4)


@pytest.mark.parametrize('sample', [-4 * MS, 9 * MS])
def test_the_nearest_sample_stands_for_a_span_that_has_none(sample):
    pushed = moved(standing(), 5 * MS, series([sample], UP + [2.0, 0.0, 0.0]))
    assert pushed.velocity == pytest.approx([0.01, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize('stamps', [[], [-200 * MS], [300 * MS]])
def test_without_a_sample_near_by_the_car_goes_straight_on(stamps):
    pushed = moved(standing(velocity=(3.0, 0.0, 0.0)), 5 * MS, series(stamps, UP + [2.0, 0.0, 0.0]))
    assert pushed.velocity == pytest.approx([3.0, 0.0, 0.0])
    assert pushed.pose.translation() == pytest.approx([0.015, 0.0, 0.0])


def test_no_sample_is_used_for_a_time_before_the_state():
    back = moved(standing(velocity=(3.0, 0.0, 0.0)), -5 * MS, series([0], UP + [2.0, 0.0, 0.0]))
    assert back.velocity == pytest.approx([3.0, 0.0, 0.0])


def scan(stamp, previous, motion):
    nowhere = np.zeros((1, 3))
    core = CoreMeasurement(stamp, 'left', CoreKind.LIDAR)
    return PreparedScan(core, nowhere, nowhere, previous, motion)


@pytest.mark.parametrize('with_odometry', [True, False])
def test_rotations_that_are_made_of_each_other_for_hours_stay_rotations(with_odometry):
    # GTSAM inverts a rotation by its transpose, so what rounding leaves grows threefold a round.
    rng = np.random.default_rng(0)
    state = State(
        0, gtsam.Pose3(gtsam.Rot3.Ypr(0.4, 0.02, 0.01), np.zeros(3)), np.zeros(3),
        gtsam.imuBias.ConstantBias(),
    )  # fmt: skip
    pose, samples = state.pose, EMPTY_SERIES
    for number in range(1, 500):
        stamp, previous = number * 100 * MS, (number - 1) * 100 * MS
        motion = pose.between(pose.retract(rng.normal(scale=1e-2, size=6)))
        if with_odometry:
            items = [scan(stamp, previous, motion)]
        else:
            items = [scan(stamp, None, None)]
            samples = series(range(previous, stamp, 10 * MS), UP)
        before = {('left', previous): pose}
        states = predict(items, state, before, samples, PARAMETERS, MAX_GAP, velocity_known=True)
        state, pose = states[stamp], states[stamp].pose
        # The estimate is a step away from the prediction, as after a solve.
        pose = state.pose.retract(rng.normal(scale=1e-3, size=6))
        state = State(stamp, pose, np.zeros(3), state.bias)
    rotation = pose.rotation().matrix()
    assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-12


TURNING = Turns(np.array([-200, 0, 200], dtype=np.int64) * MS, np.tile([0.0, 0.0, 0.5], (3, 1)))


def test_across_a_hole_the_car_goes_on_turning_as_the_matches_say():
    start = standing(velocity=(10.0, 0.0, 0.0))
    pushed = propagate(start, 200 * MS, series([], UP), PARAMETERS, MAX_GAP, TURNING)
    assert pushed.pose.rotation().yaw() == pytest.approx(0.1)
    assert pushed.pose.translation() == pytest.approx([20 * np.sin(0.1), 20 - 20 * np.cos(0.1), 0])
    assert pushed.velocity == pytest.approx([10 * np.cos(0.1), 10 * np.sin(0.1), 0])
    assert pushed.unseen == pytest.approx(0.2)


def test_the_imu_is_used_on_both_sides_of_a_hole():
    stamps = [*range(0, 100 * MS, 10 * MS), *range(400 * MS, 500 * MS, 10 * MS)]
    pushed = moved(standing(), 500 * MS, series(stamps, UP + [2.0, 0.0, 0.0]))
    # 90 ms to the last sample before the hole and 100 ms from the first one behind it.
    assert pushed.velocity == pytest.approx([0.38, 0.0, 0.0], abs=1e-6)
    assert pushed.unseen == pytest.approx(0.31)


def test_a_covered_way_is_seen_in_full():
    pushed = moved(standing(), 100 * MS, series(range(0, 100 * MS, 10 * MS), UP))
    assert pushed.unseen == 0.0


def test_far_from_any_match_nothing_is_known_of_turning():
    assert not TURNING.between(600 * MS, 700 * MS).any()
    assert TURNING.between(200 * MS, 300 * MS) == pytest.approx([0.0, 0.0, 0.5])


def test_matches_tell_how_the_car_turns():
    turn = gtsam.Pose3(gtsam.Rot3.Yaw(0.05), np.array([1.0, 0.0, 0.0]))
    found = turns_of([scan(100 * MS, 1, turn), scan(200 * MS, 100 * MS, turn)])
    assert found.stamps.tolist() == [50 * MS, 150 * MS]
    np.testing.assert_allclose(found.rates, [[0, 0, 0.5], [0, 0, 0.5]], atol=1e-7)


def test_without_an_imu_the_velocity_follows_the_matches():
    items = [
        scan(k * 100 * MS, (k - 1) * 100 * MS, gtsam.Pose3(gtsam.Rot3(), (0.5, 0, 0)))
        for k in range(2, 12)
    ]
    start = State(100 * MS, gtsam.Pose3(), np.array([10.0, 0, 0]), gtsam.imuBias.ConstantBias())
    poses = {('left', 100 * MS): gtsam.Pose3()}
    states = predict(items, start, poses, series([], UP), PARAMETERS, MAX_GAP, velocity_known=True)
    assert states[1100 * MS].velocity == pytest.approx([5.0, 0, 0], abs=0.2)
