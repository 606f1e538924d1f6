"""Several LiDARs that differ: in their rates, in whether points have times, in what they see."""

from contextlib import closing
from dataclasses import replace

import gtsam
import numpy as np
import pytest
from driven_room import STEP, room, scan, seen_from, stamp

from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import LidarScan, make_imu
from incremental_mapper.settings import make_config
from incremental_mapper.trajectory import fit_rigid

TWIST = 10.0 * gtsam.Pose3.Logmap(STEP)
TURN, SPEED = TWIST[:3], TWIST[3:]
SECONDS = 1.2
RIGHT = gtsam.Pose3(gtsam.Rot3.Yaw(-2.3), np.array([0.3, -0.6, 0.2]))
SETTINGS = {
    'lidars': {
        'left': {},
        'right': {'T_base_sensor': RIGHT.matrix()[:3].ravel().tolist()},
    },
    'selection': {'strategy': 'base'},
}


def pose(seconds):
    return gtsam.Pose3.Expmap(TWIST * seconds)


def whole(seconds, sensor='left', seed=0):
    """A scan measured at once."""
    mount = RIGHT if sensor == 'right' else gtsam.Pose3()
    return scan(seconds, seen_from(pose(seconds).compose(mount), room(3000, seed)), sensor)


def swept(seconds, sensor='right', seed=0):
    """A scan whose points are measured within the 0.1 s before its stamp, with their times."""
    cloud = room(3000, seed)
    moments = np.round(np.linspace(-0.1, 0.0, len(cloud)), 3)
    np.random.default_rng(seed).shuffle(moments)
    mount = RIGHT if sensor == 'right' else gtsam.Pose3()
    points = np.empty_like(cloud)
    for moment in np.unique(moments):
        own = moments == moment
        points[own] = seen_from(pose(seconds + moment).compose(mount), cloud[own])
    return LidarScan(stamp(seconds), sensor, points.astype(np.float32), moments.astype(np.float32))


def sector(seconds, sensor='right', seed=0):
    """What a LiDAR sees that looks ahead only, by 70 degrees."""
    full = whole(seconds, sensor, seed)
    ahead = np.abs(np.arctan2(full.points[:, 1], full.points[:, 0])) < np.radians(35.0)
    return replace(full, points=full.points[ahead])


def imu():
    rng = np.random.default_rng(4)
    force = np.cross(TURN, SPEED)
    for seconds in np.arange(-0.1, SECONDS + 0.2, 0.01):
        up = pose(seconds).rotation().unrotate(np.array([0.0, 0.0, 9.81]))
        noise = rng.normal(size=(2, 3))
        yield make_imu(stamp(seconds), 'imu', TURN + 0.002 * noise[0], force + up + 0.02 * noise[1])


def mapped(left, right):
    """The map of what two LiDARs tell, scans by their seconds."""
    items = [left(seconds, seed=round(100 * seconds)) for seconds in np.arange(0.0, SECONDS, 0.1)]
    items += right
    items = sorted([*items, *imu()], key=lambda item: item.stamp)
    with closing(Mapper(make_config(SETTINGS), ['left', 'right', 'imu'])) as mapper:
        for item in items:
            mapper.push(item)
        return mapper.finish()


def assert_true(result, count):
    """The trajectory is the driven one, and every scan of the right LiDAR has its place in it."""
    found = result.trajectory
    true = np.array([pose((one - stamp(0.0)) / 1e9).translation() for one in found.stamps])
    fit = fit_rigid(found.positions, true)
    off = found.positions @ fit[:3, :3].T + fit[:3, 3] - true
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.03
    assert sum(item.sensor == 'right' for item in result.scans) == count
    assert result.stats['components'] == 1
    assert result.stats['dropped'] == {}
    # A sector holds some directions weakly, which is said, and costs nothing.
    assert set(result.stats['notes']) <= {'right: held weakly in some direction'}
    assert result.findings == ()


RIGHTS = {
    'slow': (whole, np.arange(0.137, SECONDS, 0.5)),
    'fast': (whole, np.arange(0.013, SECONDS, 0.05)),
    'point_times': (swept, np.arange(0.037, SECONDS, 0.1)),
    'slow_with_point_times': (swept, np.arange(0.137, SECONDS, 0.4)),
    'sector': (sector, np.arange(0.037, SECONDS, 0.1)),
}


@pytest.mark.parametrize('kind', RIGHTS)
def test_a_lidar_of_another_kind_beside_a_usual_one_is_mapped(kind):
    make, times = RIGHTS[kind]
    right = [make(seconds, 'right', seed=round(1000 * seconds)) for seconds in times]
    assert_true(mapped(whole, right), len(times))
