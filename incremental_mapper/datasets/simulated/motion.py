"""The true motion of the simulated car: its pose at any time, as smooth functions."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.simulated.scene import Scene
from incremental_mapper.datasets.simulated.speed import CRUISE, SpeedProfile

Array = NDArray[np.float64]

SQUAT = 0.006
"""Pitch per longitudinal acceleration, rad/(m/s^2); the nose rises under power."""
LEAN = 0.008
"""Roll per lateral acceleration, rad/(m/s^2); the body leans out of a bend."""
SHAKE = np.array([0.0015, 0.0012, 0.0008])
"""Amplitude of each vibration at 20 km/h: heave in metres, roll and pitch in radians."""
TONES = 3


class Drive:
    """A car that follows the road of a scene with a speed profile.

    Times are seconds since the first core measurement; they may be negative.
    """

    def __init__(self, scene: Scene, profile: SpeedProfile, rng: np.random.Generator) -> None:
        self._scene = scene
        self._profile = profile
        self._tones = 2.0 * np.pi * rng.uniform(1.0, 3.0, (3, TONES))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, (3, TONES))
        cos, sin = np.cos(scene.yaw), np.sin(scene.yaw)
        self._turn = np.array([[cos, -sin], [sin, cos]])

    def poses(self, times: Array) -> tuple[Array, Rotation]:
        """T_world_base at ``times`` (N,): positions (N, 3) in metres, ENU, and rotations.

        base_link is on the ground under the rear axle, x forward, y left, z up.
        """
        arc, speed, acceleration = self._profile(times)
        point = self._scene.route.position(arc)
        heading = self._scene.route.heading(arc)
        slope = self._scene.terrain.gradient(point)
        cos, sin = np.cos(heading), np.sin(heading)
        uphill = slope[:, 0] * cos + slope[:, 1] * sin
        leftwards = slope[:, 1] * cos - slope[:, 0] * sin
        lateral = self._scene.route.curvature(arc) * speed**2
        heave, roll, pitch = self._shake(times, speed)
        roll = roll + np.arctan(leftwards) + LEAN * lateral
        pitch = pitch - np.arctan(uphill) - SQUAT * acceleration
        angles = np.stack([heading + self._scene.yaw, pitch, roll], axis=1)
        height = self._scene.terrain.height(point) + heave
        position = np.column_stack([point @ self._turn.T, height])
        return position, Rotation.from_euler('ZYX', angles)

    def speed(self, times: Array) -> Array:
        """Forward speed (N,) in m/s at ``times`` (N,)."""
        return self._profile(times)[1]

    def _shake(self, times: Array, speed: Array) -> Array:
        """Heave, roll and pitch (3, N) of the springs; they rest while the car stands."""
        waves = np.sin(times * self._tones[..., None] + self._phases[..., None]).sum(axis=1)
        shake: Array = SHAKE[:, None] * waves * (speed / CRUISE)
        return shake
