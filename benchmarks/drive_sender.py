"""A 64-beam LiDAR and an IMU of a car in a street, sent live by a process of its own.

    python benchmarks/drive_sender.py [--seconds 60]

Clouds of 2.4 MB at 10 Hz on /points_top (the points of an instant), samples at 100 Hz on /imu. The
car runs to and fro over 400 m at up to 8 m/s between two walls with buttresses, so that the map
ends growing while the trajectory goes on. It prints how many clouds were sent, and how late.
"""

import argparse
import time

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import Imu, PointCloud2, PointField

BEAMS, COLUMNS, POINT_STEP = 64, 780, 48
HALF_WAY, TURN = 200.0, 0.04
"""The place is HALF_WAY (1 - cos(TURN t)) metres."""
HEIGHT, WALL, DEPTH, DISTANCE = 1.8, 9.0, 2.0, 13.0
"""Of the LiDAR over the ground; of the walls from the middle; of buttresses; between these; m."""
RANGE, NOISE = 80.0, 0.01
GRAVITY = 9.81
STEP = 0.01
SAMPLES_A_CLOUD = 10


def main() -> None:
    """Send and end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=60.0)
    args = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node('drive_sender')
    reliable = ReliabilityPolicy.RELIABLE
    clouds = node.create_publisher(
        PointCloud2, '/points_top', QoSProfile(depth=10, reliability=reliable)
    )
    samples = node.create_publisher(Imu, '/imu', QoSProfile(depth=200, reliability=reliable))
    while clouds.get_subscription_count() == 0 or samples.get_subscription_count() == 0:
        time.sleep(0.01)
    rays, rng = directions(), np.random.default_rng(1)
    begin, origin = time.monotonic() + 1.0, node.get_clock().now().nanoseconds
    late = 0.0
    for number in range(round(args.seconds / STEP)):
        passed = number * STEP
        stamp = Time(nanoseconds=origin + number * round(STEP * 1e9)).to_msg()
        cloud = None
        if number % SAMPLES_A_CLOUD == 0:
            place = HALF_WAY * (1.0 - np.cos(TURN * passed))
            cloud = message(seen(rays, place, rng))
        time.sleep(max(begin + passed - time.monotonic(), 0.0))
        late = max(late, time.monotonic() - begin - passed)
        sample = Imu()
        sample.header.stamp, sample.header.frame_id = stamp, 'imu'
        sample.linear_acceleration.x = HALF_WAY * TURN**2 * np.cos(TURN * passed)
        sample.linear_acceleration.z = GRAVITY
        sample.orientation_covariance[0] = -1.0
        samples.publish(sample)
        if cloud is not None:
            cloud.header.stamp = stamp
            clouds.publish(cloud)
    time.sleep(2.0)
    count = -(-round(args.seconds / STEP) // SAMPLES_A_CLOUD)
    print(f'{count} clouds of {BEAMS * COLUMNS * POINT_STEP} bytes, at most {late:.2f} s late')
    rclpy.shutdown()


def directions() -> NDArray[np.float64]:
    """The beams, (N, 3)."""
    up = np.radians(np.linspace(-24.8, 2.0, BEAMS))[:, None]
    round_ = np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False)[None, :]
    parts = (np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up) + 0.0 * round_)
    return np.stack([part.ravel() for part in parts], axis=1)


def seen(rays: NDArray[np.float64], place: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Points (N, 3) in the LiDAR's frame where beams end at that place of the street."""
    x, y, z = rays.T
    with np.errstate(divide='ignore', invalid='ignore'):
        nearest = np.where(z < 0.0, -HEIGHT / z, np.inf)
        nearest = np.minimum(nearest, WALL / np.abs(y))
        first = np.floor((place - RANGE) / DISTANCE)
        for number in range(int(first), int(first + 2.0 * RANGE / DISTANCE) + 2):
            distance = (number * DISTANCE - place) / x
            # Buttresses of two widths, so that none is like its neighbour.
            inner = WALL - DEPTH * (1.0 + 0.5 * np.sin(1.7 * number))
            hit = (distance > 0.0) & (np.abs(y * distance) > inner)
            nearest = np.where(hit, np.minimum(nearest, distance), nearest)
    nearest[nearest > RANGE] = np.nan
    nearest += NOISE * rng.standard_normal(len(nearest))
    return (rays * nearest[:, None]).astype(np.float32)


def message(points: NDArray[np.float32]) -> PointCloud2:
    """The cloud, with 48 bytes a point as those of an Ouster."""
    table = np.zeros((len(points), POINT_STEP // 4), dtype='<f4')
    table[:, :3] = points
    fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
        for k, name in enumerate('xyz')
    ]
    cloud = PointCloud2(height=BEAMS, width=COLUMNS, fields=fields, point_step=POINT_STEP)
    cloud.header.frame_id = 'top'
    cloud.row_step = POINT_STEP * COLUMNS
    cloud.data = table.tobytes()
    return cloud


if __name__ == '__main__':
    main()
