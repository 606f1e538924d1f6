"""A LiDAR with an IMU carried by hand through a hall: quick turns, steps and jolts; no GNSS.

The hall is of boxes, whose distances are found without a ray caster. Times are seconds since the
start; the world is level, metres.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.measurements import (
    NANOSECONDS,
    ImuSample,
    LidarScan,
    make_imu,
    make_scan,
)
from incremental_mapper.trajectory import Trajectory

Array = NDArray[np.float64]

EPOCH = 1_700_000_000 * NANOSECONDS
SENSOR = 'lidar'
PERIOD, COLUMNS, ROWS = 0.1, 600, 24
ELEVATIONS = np.radians(np.linspace(-30.0, 30.0, ROWS))
RANGE_NOISE = 0.01
IMU_RATE = 200
T_BASE_IMU = (0.06, -0.03, -0.09, 0.0, 0.0, np.sin(0.4), np.cos(0.4))
GYRO_NOISE, FORCE_NOISE = 0.002, 0.02
"""rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), of a cheap IMU."""
GYRO_BIAS, FORCE_BIAS = 0.01, 0.1
"""Standard deviations of the biases, rad/s and m/s^2."""
SETTINGS = {
    'lidars': {SENSOR: {}},
    'imu': {'T_base_sensor': list(T_BASE_IMU)},
    'odometry': {'min_range': 0.5, 'voxel_size': 0.3},
    'preintegration': {'gyroscope_noise': GYRO_NOISE, 'accelerometer_noise': FORCE_NOISE},
    'graph': {'prior_sigma_accelerometer_bias': 0.3, 'prior_sigma_gyroscope_bias': 0.02},
}
"""What a mapper has to know of the sensors."""
GRAVITY = 9.81
H = 1e-3
"""Half a difference in seconds."""
HALL = np.array([[-12.0, -9.0, -1.5], [12.0, 9.0, 3.5]])
"""Two corners, metres."""
SLOW, QUICK = 0.15, 1.3
"""Hz of the turns to the left and to the right, and of those on top of them."""
TURN = 2.0
"""Amplitude of the rate of each of the two, rad/s: together they reach 4."""
JOLTS, JOLT, JOLT_SHIFT = 0.7, 0.04, 0.012
"""Seconds from one jolt to the next, how long it is, and how far it shifts the sensor, metres: most
are of 1 g, some of 2 g."""


class Walk:
    """Where the sensor is, as a smooth function of time, and what it measures there."""

    def __init__(self, seed: int = 0) -> None:
        """Make a walk and its hall; the same seed makes the same ones."""
        rng = np.random.default_rng([seed, 7])
        self._rng = np.random.default_rng([seed, 8])
        low = np.column_stack([rng.uniform(-11, 10, 14), rng.uniform(-8, 7, 14)])
        # The walk is a ring of 3 to 5 m around the middle, which stays free.
        low = low[np.abs(np.linalg.norm(low + 0.5, axis=1) - 4.0) > 2.2]
        size = rng.uniform([0.4, 0.4, 1.0], [1.4, 1.4, 4.0], (len(low), 3))
        corners = np.column_stack([low, np.full(len(low), HALL[0, 2])])
        self._boxes = np.stack([corners, corners + size], axis=1)
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 8)
        self._jolts = rng.normal(size=(1000, 3)) * JOLT_SHIFT

    def poses(self, times: Array) -> tuple[Array, Rotation]:
        """T_world_base at ``times`` (N,): positions (N, 3) and rotations."""
        phase = self._phases[:, None]
        times = _warmed_up(times)
        way = 0.22 * times + 0.2 * np.sin(0.9 * times + phase[0])
        radius = 4.0 + 0.5 * np.sin(0.31 * times + phase[1])
        step = 0.03 * np.sin(2.0 * np.pi * 1.8 * times + phase[2])
        position = np.stack([radius * np.cos(way), radius * np.sin(way), step], axis=1)
        number = np.floor(times / JOLTS).astype(int)
        since = times - (number + 0.5) * JOLTS
        bump = np.exp(-0.5 * (since / JOLT) ** 2)
        position = position + bump[:, None] * self._jolts[number % len(self._jolts)]
        yaw = sum(
            TURN / (2.0 * np.pi * rate) * np.sin(2.0 * np.pi * rate * times + one)
            for rate, one in ((SLOW, phase[3]), (QUICK, phase[4]))
        )
        pitch = 0.15 * np.sin(2.0 * np.pi * 0.9 * times + phase[5])
        roll = 0.12 * np.sin(2.0 * np.pi * 1.1 * times + phase[6])
        return position, Rotation.from_euler('ZYX', np.stack([yaw, pitch, roll], axis=1))

    def truth(self, seconds: float) -> Trajectory:
        """The true poses every 10 ms."""
        times = np.arange(-1.0, seconds + 1.0, 0.01)
        position, rotation = self.poses(times)
        stamps = EPOCH + np.rint(times * NANOSECONDS).astype(np.int64)
        return Trajectory(stamps, position, rotation.as_quat())

    def measurements(self, seconds: float) -> Iterator[LidarScan | ImuSample]:
        """Scans stamped at the start of their sweeps, told at the end, and samples between them."""
        bias = self._rng.normal(size=(2, 3)) * [[GYRO_BIAS], [FORCE_BIAS]]
        per_sweep = round(PERIOD * IMU_RATE)
        for number in range(round(seconds / PERIOD)):
            start = number * PERIOD
            times = np.linspace(start, start + PERIOD, per_sweep, endpoint=False)
            yield from self._samples(times, bias)
            yield self._sweep(start)

    def true_samples(self, times: Array) -> tuple[Array, Array]:
        """Rates and specific forces (N, 3) of an ideal IMU, in its own axes."""
        before, now, after = (self._imu(times + shift) for shift in (-H, 0.0, H))
        acceleration = (after[0] - 2.0 * now[0] + before[0]) / H**2
        gyro = (before[1].inv() * after[1]).as_rotvec() / (2.0 * H)
        return gyro, now[1].inv().apply(acceleration + [0.0, 0.0, GRAVITY])

    def _samples(self, times: Array, bias: Array) -> Iterator[ImuSample]:
        gyro, force = self.true_samples(times) + bias[:, None]
        noise = self._rng.normal(size=(2, len(times), 3)) * np.sqrt(IMU_RATE)
        gyro, force = gyro + GYRO_NOISE * noise[0], force + FORCE_NOISE * noise[1]
        for time, rate, push in zip(times, gyro, force, strict=True):
            yield make_imu(EPOCH + round(float(time) * NANOSECONDS), 'imu', rate, push)

    def _imu(self, times: Array) -> tuple[Array, Rotation]:
        position, rotation = self.poses(times)
        return position + rotation.apply(T_BASE_IMU[:3]), rotation * Rotation.from_quat(
            T_BASE_IMU[3:]
        )

    def _sweep(self, start: float) -> LidarScan:
        times = np.linspace(0.0, PERIOD, COLUMNS, endpoint=False)
        azimuth = -2.0 * np.pi * times / PERIOD
        level = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        rays = np.empty((COLUMNS, ROWS, 3))
        rays[..., :2] = level[:, None] * np.cos(ELEVATIONS)[None, :, None]
        rays[..., 2] = np.sin(ELEVATIONS)
        position, rotation = self.poses(start + times)
        turned = np.einsum('cij,crj->cri', rotation.as_matrix(), rays).reshape(-1, 3)
        distance = self._distances(np.repeat(position, ROWS, axis=0), turned)
        distance = distance + self._rng.normal(scale=RANGE_NOISE, size=len(distance))
        stamp = EPOCH + round(start * NANOSECONDS)
        points = rays.reshape(-1, 3) * distance[:, None]
        return make_scan(stamp, SENSOR, points, np.repeat(times, ROWS))

    def _distances(self, origins: Array, directions: Array) -> Array:
        """How far it is along rays (N, 3) to a wall or a box."""
        safe = np.where(np.abs(directions) < 1e-9, 1e-9, directions)
        walls: Array = np.max((HALL[:, None] - origins) / safe, axis=0).min(axis=1)
        for low, high in self._boxes:
            both = np.stack([(low - origins) / safe, (high - origins) / safe])
            near, far = both.min(axis=0).max(axis=1), both.max(axis=0).min(axis=1)
            hit = (near <= far) & (near > 0.0)
            walls = np.where(hit, np.minimum(walls, near), walls)
        return walls


def _warmed_up(times: Array) -> Array:
    """Time as the motion has it: it rests for a second, and is itself from the third one on."""
    since = np.clip((times - 1.0) / 2.0, 0.0, 1.0)
    # The integral of a smooth step from 0 to 1.
    warmed: Array = 2.0 * (since**3 - 0.5 * since**4) + np.maximum(times - 3.0, 0.0)
    return warmed
