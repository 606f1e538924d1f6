"""The newest state: twist along the axes of base_link, and covariances that samples agree with."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from turning_car import MS, SPEED, TURN, imu_series, known_state, settings, truth, velocity

from incremental_mapper.datasets.open import open_source
from incremental_mapper.frontend.imu_preintegration import EMPTY_SERIES
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.newest_state import newest_state
from incremental_mapper.measurements import ImuSample
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.smoothing.graph_state import GraphState

SERIES = imu_series(-20 * MS, 20 * MS)


def test_before_the_first_window_there_is_none():
    assert newest_state(GraphState(), SERIES, settings()) is None


def test_twist_of_a_car_on_a_bend():
    found = newest_state(known_state(), SERIES, settings())
    assert found.pose.equals(truth(0), 1e-6)
    assert found.pose.rotation().unrotate(found.velocity) == pytest.approx(SPEED, abs=1e-6)
    assert found.rate == pytest.approx(TURN, abs=1e-9)
    noise = settings().preintegration.gyroscope_noise
    bias = settings().graph.prior_sigma_gyroscope_bias
    # Samples are 2 ms apart; the bias is as uncertain as its prior says.
    assert np.diag(found.rate_covariance) == pytest.approx(noise**2 / 0.002 + bias**2, rel=1e-3)


def test_the_rate_is_along_the_axes_of_the_car_however_the_imu_is_mounted():
    R_base_imu = gtsam.Rot3.RzRyRx(0.4, -0.3, 1.9)
    turn = R_base_imu.toQuaternion()
    pose = [0, 0, 0, turn.x(), turn.y(), turn.z(), turn.w()]
    turned = replace(SERIES, gyro=SERIES.gyro @ R_base_imu.matrix())
    config = settings(imu={'T_base_sensor': pose})
    assert newest_state(known_state(), turned, config).rate == pytest.approx(TURN, abs=1e-9)


def test_velocity_covariance_is_what_samples_of_attitude_and_velocity_have():
    found = newest_state(known_state(sigma=0.02), SERIES, settings())
    rng = np.random.default_rng(2)
    turns = rng.normal(scale=0.002, size=(40_000, 3))
    speeds = velocity(0) + rng.normal(scale=0.02, size=(40_000, 3))
    samples = [
        truth(0).rotation().retract(turn).unrotate(speed)
        for turn, speed in zip(turns, speeds, strict=True)
    ]
    expected = np.cov(np.array(samples).T)
    assert np.abs(found.velocity_covariance - expected).max() < 0.03 * expected.max()


def test_a_single_sample_is_no_more_certain_than_one_of_many():
    single = SERIES.nearest(0)
    alone, among = (
        newest_state(known_state(), series, settings()).rate_covariance
        for series in (single, imu_series(-20 * MS, 20 * MS, 10 * MS))
    )
    assert (np.diag(alone) >= np.diag(among)).all()


@pytest.mark.parametrize('series', [EMPTY_SERIES, imu_series(-900 * MS, -500 * MS)])
def test_without_a_sample_near_the_rate_is_unknown(series):
    found = newest_state(known_state(), series, settings())
    assert found.rate is None and found.rate_covariance is None


def test_without_a_velocity_in_the_graph_its_covariance_is_unknown():
    assert newest_state(known_state(False), SERIES, settings()).velocity_covariance is None


def test_the_rate_is_known_where_a_window_ends_with_its_newest_scan(light_drive):
    """The newest sample is then the one before it, and no span of the next window begins there."""
    tree = {'selection': {'strategy': 'min_time_shift'}, 'odometry': {'method': 'gicp'}}
    source = open_source(light_drive, tree)
    config = effective_config(source, tree, 'test')
    measurements = list(source.measurements())

    def run(left_out):
        mapper, found = Mapper(config, list(source.info.counts)), []
        for item in measurements:
            inertial = isinstance(item, ImuSample)
            if not (inertial and any(a <= item.stamp < b for a, b in left_out)):
                found += [
                    (window.end, mapper.newest()) for window in mapper.push(item) if window.clusters
                ]
        return found

    ends = [(newest.stamp, end) for end, newest in run([])]
    found = run(ends)
    assert len(found) > 10
    assert all(newest.rate is not None for _, newest in found)
