"""A LiDAR in a hand: scan matching follows quick turns and jolts where the IMU leads it."""

from contextlib import closing
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.datasets.simulated.handheld import EPOCH, SETTINGS, Walk
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import ImuSample, LidarScan
from incremental_mapper.settings import make_config, merge
from incremental_mapper.trajectory import fit_rigid

SECONDS = 5.0


@pytest.fixture(scope='module')
def measurements():
    return list(Walk(1).measurements(SECONDS))


def errors(measurements, **odometry):
    """Distances from the truth of a chain of matches after the best rigid fit, and notes."""
    end = FrontEnd(make_config(merge(SETTINGS, {'odometry': odometry})), imu_expected=True)
    begun = []
    for item in measurements:
        if isinstance(item, ImuSample):
            end.imu(item)
        else:
            begun.append(end.start((item,)))
        end.passed(item.stamp)
    pose, found, stamps = gtsam.Pose3(), [], []
    for preparation in begun:
        (scan,) = end.collect(preparation)
        if scan.T_previous_current is not None:
            pose = pose.compose(scan.T_previous_current)
        found.append(pose.translation())
        stamps.append(scan.core.stamp)
    truth = Walk(1).truth(SECONDS).interpolate(np.array(stamps)).positions
    found = np.array(found)
    fit = fit_rigid(found, truth)
    return np.linalg.norm(found @ fit[:3, :3].T + fit[:3, 3] - truth, axis=1), end.notes


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_imu_carries_scan_matching_through_quick_turns(measurements):
    rates = [np.linalg.norm(item.gyro) for item in measurements if isinstance(item, ImuSample)]
    assert max(rates) > 3.5
    led, notes = errors(measurements)
    assert rms(led) < 0.01 and not notes
    alone, _ = errors(measurements, imu_guess=False)
    assert rms(alone) > 0.03  # after 5 s; it grows on


def knocked(item):
    """A gyroscope that says 30 rad/s more for 30 ms."""
    ms = (item.stamp - EPOCH) / 1e6
    if isinstance(item, ImuSample) and 3500.0 <= ms < 3530.0:
        return replace(item, gyro=item.gyro + 30.0)
    return item


def test_knock_of_the_imu_costs_no_match(measurements):
    led, notes = errors([knocked(item) for item in measurements])
    assert rms(led) < 0.05
    assert 'lidar: match rejected' not in notes


@pytest.mark.parametrize('rate', [5.0, 10.0, 20.0])
def test_scans_tell_where_the_imu_is_knocked_for_longer(measurements, rate):
    # By what it says, a match may end far off and be plausible; by steady motion it fits.
    during = range(EPOCH + 1_500_000_000, EPOCH + 1_700_000_000)
    sent = [
        replace(item, gyro=item.gyro + [0.0, 0.0, rate])
        if isinstance(item, ImuSample) and item.stamp in during
        else item
        for item in measurements
    ]
    led, notes = errors(sent)
    assert rms(led) < 0.008 and not notes


def test_imu_with_wrong_axes_is_left_to_itself(measurements):
    turned = [
        replace(item, gyro=item.gyro[[2, 0, 1]]) if isinstance(item, ImuSample) else item
        for item in measurements
    ]
    wrong, _ = errors(turned)
    alone, _ = errors(measurements, imu_guess=False)
    assert rms(wrong) < 1.5 * rms(alone)


def test_hole_in_the_imu_is_bridged_by_steady_motion(measurements):
    def missing(item):
        return isinstance(item, ImuSample) and 800.0 < (item.stamp - EPOCH) / 1e6 < 1300.0

    found, notes = errors([item for item in measurements if not missing(item)])
    assert rms(found) < 0.03 and not notes


def test_measurements_that_come_one_by_one_make_the_same_map(measurements):
    # Late as a driver is: scans when their sweeps are over, the IMU 30 ms after that.
    def arrival(item):
        return item.stamp + (100_000_000 if isinstance(item, LidarScan) else 130_000_000)

    short = [item for item in measurements if item.stamp - EPOCH < 2_500_000_000]
    maps = []
    for predict, order in ((False, short), (True, sorted(short, key=arrival))):
        with closing(Mapper(make_config(SETTINGS), ['lidar', 'imu'], predict)) as mapper:
            for item in order:
                mapper.push(item)
            maps.append(mapper.finish().trajectory)
    assert np.array_equal(maps[0].stamps, maps[1].stamps)
    assert np.array_equal(maps[0].positions, maps[1].positions)
