"""Which settings an input starts from, by its sensors: those that the shipped files hold."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from incremental_mapper.config import Tree
from incremental_mapper.results.lidar_shape import LidarShape

KAIST, KITTI, S3E = 'config/kaist.yaml', 'config/kitti.yaml', 'config/s3e.yaml'

TILTED = 20.0
"""Degrees from which a LiDAR counts as tilted. KAIST's are tilted by 45; a level mount is within 5,
and one that looks at the kerb by 10 to 15 still sees walls first."""
DENSE = 60_000
"""Points of a dense scan: a VLP-16 has 30 000 rays, an HDL-64 and an OS1-128 give 107 000 to
120 000 points."""
MANY = 10_000
"""Points of a scan from which matching it takes several times as long as handing it to another
process: 64 beams are mapped twice as fast with one."""
QUICK = 50.0
"""Samples a second of an IMU that tells the motion in a long window: with 0.3 s KITTI's rotations
are a tenth worse than those of base with an IMU of 100 Hz (0.046 and 0.041 degrees from pose to
pose); with one of 10 Hz they were worse by half before such samples were believed less."""
LOW = 1.3
"""Metres above the ground below which a LiDAR is on a small vehicle: S3E's has 0.9 m, those on the
roofs of cars 1.7 m to 2.1 m."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One setting and why it has its value.

    ``place`` is its name, such as ``window.duration``; ``file`` the shipped file that has it too.
    """

    place: str
    value: Any
    why: str
    file: str

    @property
    def text(self) -> str:
        """The setting as one writes it."""
        value = str(self.value).lower() if isinstance(self.value, bool) else self.value
        return f'{self.place}: {value}'

    def tree(self) -> Tree:
        """The setting as nested dictionaries."""
        tree: Tree = {}
        *sections, name = self.place.split('.')
        branch = tree
        for section in sections:
            branch = branch.setdefault(section, {})
        branch[name] = self.value
        return tree


def starting_point(
    shapes: Mapping[str, LidarShape], imu_rate: float = 0.0, cores: int = 1
) -> tuple[Choice, ...]:
    """Choose settings for the sensors that there are.

    Args:
        shapes: what each LiDAR is like.
        imu_rate: samples of the IMU a second, 0 without one.
        cores: of the machine.

    Returns:
        What differs from the defaults; none where those are right.
    """
    chosen: list[Choice] = []
    tilted = {name: shape.tilt for name, shape in shapes.items() if shape.tilt > TILTED}
    if tilted:
        angles = ' and '.join(f'{name} by {tilt:.0f} degrees' for name, tilt in tilted.items())
        chosen.append(
            Choice(
                'odometry.match_range',
                45.0,
                f'tilted LiDARs ({angles}): further away their rings are too far apart to match',
                KAIST,
            )
        )
    if len(shapes) == 1 and imu_rate > QUICK:
        chosen.append(
            Choice(
                'window.duration',
                0.3,
                'one LiDAR: 0.2 s holds two scans and seldom a fix, which leaves little to choose',
                KITTI,
            )
        )
    points = max((shape.points for shape in shapes.values()), default=0)
    if points > DENSE:
        why = f'{points} points a scan: many of them see the same, and tell less than so many'
        chosen.append(Choice('odometry.covariance_scale', 75.0, why, KITTI))
    if points > MANY and cores > 1:
        why = 'two cores or more: scans are matched beside the windows, with the same results'
        chosen.append(Choice('odometry.processes', True, why, KITTI if len(shapes) == 1 else KAIST))
    heights = [shape.height for shape in shapes.values()]
    if heights and all(height is not None and 0.0 < height < LOW for height in heights):
        why = f'LiDAR {min(filter(None, heights)):.1f} m above the ground: a small vehicle, near '
        chosen.append(Choice('odometry.min_range', 1.0, why + 'points are surroundings', S3E))
    return tuple(chosen)
