"""Where the sensors sit on the simulated car, with angles like those of the KAIST car."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def _mount(translation: tuple[float, float, float], degrees: tuple[float, float, float]) -> Array:
    """T_base_sensor (4, 4) of a position in metres and yaw, pitch, roll in degrees."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler('ZYX', degrees, degrees=True).as_matrix()
    matrix[:3, 3] = translation
    return matrix


# The spin axes lean 45 degrees backwards and to the side. The odd fractions are what mounting
# leaves, so that nobody gets away with ideal angles.
T_BASE_LEFT = _mount((-0.44, 0.41, 1.91), (135.6, 44.7, 0.8))
T_BASE_RIGHT = _mount((-0.45, -0.42, 1.91), (-135.3, 45.2, -0.5))
T_BASE_IMU = _mount((-0.07, 0.0, 1.7), (0.0, 0.0, 0.0))
T_BASE_VRS = _mount((-0.32, 0.0, 1.7), (0.0, 0.0, 0.0))
