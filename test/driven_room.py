"""A room of three walls, and a car that drives in it: what its LiDAR would see."""

import gtsam
import numpy as np

from incremental_mapper.config import OdometryMethod
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.measurements import LidarScan
from incremental_mapper.settings import make_config

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_000_000_000
METHODS = list(OdometryMethod)
STEP = gtsam.Pose3(gtsam.Rot3.Ypr(0.02, 0.003, -0.002), np.array([0.4, 0.05, 0.01]))


def room(count=6000, seed=0):
    """Random points on the floor and on two walls of a room of 30 m, in the room's frame."""
    rng = np.random.default_rng(seed)
    walls = []
    for axis in range(3):
        points = rng.uniform(0.0, 30.0, size=(count // 3, 3))
        points[:, axis] = rng.normal(scale=0.005, size=count // 3)
        walls.append(points)
    return np.vstack(walls) - np.array([12.0, 14.0, 2.0])


def seen_from(pose, points):
    """What a car at ``pose`` sees of the room."""
    return (points - pose.translation()) @ pose.rotation().matrix()


def poses(count, step=STEP):
    track = [gtsam.Pose3()]
    for _ in range(count - 1):
        track.append(track[-1].compose(step))
    return track


def assert_close(found, expected, metres, radians):
    error = expected.localCoordinates(found)
    assert np.linalg.norm(error[3:]) < metres
    assert np.linalg.norm(error[:3]) < radians


def scan(seconds, points, sensor='left'):
    return LidarScan(EPOCH + round(seconds * SECOND), sensor, points.astype(np.float32))


def stamp(seconds):
    return EPOCH + round(seconds * SECOND)


def front_end(**odometry):
    return FrontEnd(make_config({'odometry': odometry, 'lidars': {'left': {}, 'right': {}}}))


def drive(end, times, sensor='left'):
    """Prepared scans of a car that moves by STEP every 0.1 s."""
    prepared = []
    for seconds in times:
        pose = gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * (seconds * 10))
        prepared += end.prepare((scan(seconds, seen_from(pose, room(seed=round(seconds * 10)))),))
    return prepared
