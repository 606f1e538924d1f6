"""What the factors of a window are made of: the state to start from, and where ENU lies."""

import gtsam
import numpy as np
import pytest
from turning_car import (
    ARM,
    CHAINS,
    ENU_OFFSET,
    MS,
    assert_poses,
    fix,
    imu_series,
    known_state,
    problem_of,
    scan,
    truth,
    velocity,
)
from turning_car import settings as car_settings

from incremental_mapper.frontend.dead_reckoning import turns_of
from incremental_mapper.frontend.imu_preintegration import (
    EMPTY_SERIES,
    ImuSeries,
    preintegration_parameters,
)
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.selection.window_problem import fix_spread, window_inputs
from incremental_mapper.smoothing.graph_state import GraphState

WINDOW = {40 * MS: {'gps'}, 60 * MS: {'left'}}


def inputs_of(items, state, series, orientation=None, config=None):
    config = car_settings() if config is None else config
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    return window_inputs(items, state, series, orientation, parameters, config, turns_of(items))


def test_first_fix_puts_enu_where_the_antenna_is_then():
    state = known_state()
    state.enu_offset = None
    found = problem_of(WINDOW, state).inputs.enu_offset
    # Whatever the car's heading, the antenna is where the fix says.
    assert fix(40 * MS).enu + found == pytest.approx(truth(40 * MS).transformFrom(ARM), abs=2e-3)
    assert np.linalg.norm(truth(0).rotation().rotate(ARM) - ARM) > 0.1


def test_enu_stays_where_it_was_put_and_is_nowhere_before_a_fix():
    assert problem_of(WINDOW).inputs.enu_offset.tolist() == ENU_OFFSET.tolist()
    state = known_state()
    state.enu_offset = None
    assert problem_of({60 * MS: {'left'}}, state).inputs.enu_offset.tolist() == [0.0] * 3


def test_window_starts_from_the_head_and_its_own_velocity_and_bias():
    state = known_state()
    state.last_velocity = np.full(3, 99.0)
    state.last_bias = gtsam.imuBias.ConstantBias(np.ones(3), np.ones(3))
    start = problem_of(WINDOW, state).inputs.head_state
    assert start.stamp == 0
    assert_poses(start.pose, truth(0))
    assert start.velocity == pytest.approx(velocity(0), abs=1e-6)
    assert start.bias.vector() == pytest.approx(np.zeros(6), abs=1e-9)


def test_head_without_velocity_takes_the_last_one_that_was_known():
    state = known_state(head_inertial=False)
    state.last_velocity = np.array([3.0, 2.0, 1.0])
    state.last_bias = gtsam.imuBias.ConstantBias(np.full(3, 0.1), np.full(3, 0.01))
    start = problem_of(WINDOW, state).inputs.head_state
    assert start.velocity.tolist() == [3.0, 2.0, 1.0]
    assert start.bias.vector().tolist() == [0.1] * 3 + [0.01] * 3


def test_states_are_predicted_where_the_car_is():
    problem = problem_of({**WINDOW, 90 * MS: {'right'}, 120 * MS: {'left'}})
    for stamp in (40 * MS, 60 * MS, 90 * MS, 120 * MS):
        assert_poses(problem.inputs.states[stamp].pose, truth(stamp))


def test_scan_is_predicted_from_where_its_last_one_stands_in_its_cluster():
    # Without the IMU, nothing but odometry from the right LiDAR's last scan tells of the turn.
    state = known_state()
    problem = problem_of({90 * MS: {'right'}}, state, series=EMPTY_SERIES)
    assert_poses(problem.inputs.states[90 * MS].pose, truth(90 * MS))
    assert CHAINS['right'] != 0


def level(rotation):
    """An IMU that stands in a car of this attitude."""
    force = rotation.unrotate(np.array([0.0, 0.0, 9.81]))
    stamps = np.arange(0, 100 * MS, 10 * MS, dtype=np.int64)
    return ImuSeries(stamps, np.zeros((10, 3)), np.tile(force, (10, 1)))


@pytest.mark.parametrize('turned', [False, True])
def test_first_pose_is_level_by_gravity_with_the_heading_of_the_imu(turned):
    attitude = gtsam.Rot3.Ypr(0.9, 0.05, -0.03)
    R_base_imu = gtsam.Rot3.Yaw(1.3) if turned else gtsam.Rot3()
    quaternion = R_base_imu.toQuaternion()
    pose = [0, 0, 0, quaternion.x(), quaternion.y(), quaternion.z(), quaternion.w()]
    config = car_settings(imu={'T_base_sensor': pose})
    at_imu = level(attitude.compose(R_base_imu))
    seen = attitude.compose(R_base_imu).toQuaternion()
    orientation = np.array([seen.x(), seen.y(), seen.z(), seen.w()])
    start = inputs_of([scan(MS)], GraphState(), at_imu, orientation, config).head_state
    assert start.pose.rotation().equals(attitude, 1e-6)
    assert start.pose.translation().tolist() == [0.0] * 3
    assert start.velocity.tolist() == [0.0] * 3
    without = inputs_of([scan(MS)], GraphState(), at_imu, None, config).head_state
    assert without.pose.rotation().equals(gtsam.Rot3.Ypr(0.0, 0.05, -0.03), 1e-6)
    blind = inputs_of([scan(MS)], GraphState(), EMPTY_SERIES, orientation, config).head_state
    assert blind.pose.rotation().equals(gtsam.Rot3.Yaw(attitude.yaw()), 1e-6)


def test_fix_is_trusted_the_less_the_further_it_is_from_the_first_one():
    state = known_state()
    items = [fix(stamp) for stamp in (40 * MS, 240 * MS)]
    apart = np.linalg.norm((items[1].enu - items[0].enu)[:2])
    assert fix_spread(state, items) == {
        40 * MS: (0.0, 0.0),
        240 * MS: pytest.approx((2.0 * apart, 0.0)),
    }


def test_series_and_frontier_are_handed_on():
    series = imu_series(0, 100 * MS)
    found = inputs_of([scan(50 * MS)], GraphState(), series)
    assert found.series is series
    assert found.frontier == Frontier()
    assert list(found.prepared) == [scan(50 * MS).core]


def test_first_window_has_no_cluster_to_connect_from():
    assert problem_of(WINDOW, GraphState()).head is None
    assert problem_of(WINDOW).head == 0
