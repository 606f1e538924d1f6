"""How a LiDAR is turned on the car, where nobody tells: by the ground and by the way.

The ground tells roll and pitch, the way of a car that drives on tells the yaw. Both come from the
LiDAR alone, and hold each other to account: a car drives along the ground.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.ground import TILTED, Ground
from incremental_mapper.checks.motions import SHORTEST, STRAIGHT, angle
from incremental_mapper.config import Tree
from incremental_mapper.geometry import written_numbers

LOWEST, HIGHEST = 0.5, 4.0
"""Metres from a LiDAR to the ground, on anything from a small robot's mast to a lorry's roof."""
ALONG = 4.0
"""Degrees between the ground and the way, at most. On simulated drives with a tilt of 45 degrees
it is 0.1 to 0.9."""
BELOW, DEEP = 0.05, 0.4
"""Share of the near points that lie so many metres below the ground, at most: a wall of a wide
street has points on both sides."""
ALIKE = 5.0
"""Degrees between the LiDAR's vertical and the IMU's gravity, both in their own frames, below
which the two are one unit, turned alike."""


def level_mount(
    ground: Ground,
    moves: NDArray[np.float64],
    gravity: NDArray[np.float64] | None,
    imu_unplaced: bool,
) -> Finding | None:
    """Tell how a LiDAR of an unknown place is turned.

    Args:
        ground: What its clouds say in its own frame, taken for that of the car.
        moves: Its matches' translations (N, 3) in the same frame, metres.
        gravity: Mean acceleration (3,) by the IMU in its own frame, None without one, m/s^2.
        imu_unplaced: Whether nobody tells where the IMU is, either.

    Returns:
        A finding with the pose that mends it; None where the LiDAR is level, or nothing is certain.
    """
    way = moves.sum(axis=0)
    length = float(np.linalg.norm(way))
    driven = float(np.linalg.norm(moves, axis=1).sum())
    if ground.degrees < TILTED or length < SHORTEST or length < STRAIGHT * driven:
        return None
    distance = abs(ground.offset)
    up = -np.sign(ground.offset) * ground.normal
    slope = float(np.degrees(np.arcsin(np.clip(up @ way / length, -1.0, 1.0))))
    under = float(np.mean(ground.points @ up < -distance - DEEP))
    if not LOWEST < distance < HIGHEST or abs(slope) > ALONG or under > BELOW:
        return None
    forward = way - (way @ up) * up
    forward /= np.linalg.norm(forward)
    turn = np.stack([forward, np.cross(up, forward), up])
    mount = np.eye(4)
    mount[:3, :3] = turn
    pose = written_numbers(mount)
    settings: Tree = {'lidars': {ground.sensor: {'T_base_sensor': pose}}}
    line = f'lidars.{ground.sensor}.T_base_sensor: {pose}'
    if imu_unplaced and gravity is not None and angle(gravity, up) < ALIKE:
        settings['imu'] = {'T_base_sensor': pose}
        line += ' and the same of the IMU, whose gravity points alike'
    return Finding(
        'tilted_mount',
        Severity.MENDED,
        ground.sensor,
        f'nobody tells how it is turned; by the ground, {distance:.1f} m from it, and by '
        f'{length:.0f} m of way along it, it is turned by '
        f'{np.degrees(Rotation.from_matrix(turn).magnitude()):.0f} degrees',
        f'turned as with {line} (the lever arm is not known, nor whether the car drove backwards)',
        settings,
    )
