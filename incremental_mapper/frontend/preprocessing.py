"""From a raw scan to points in base_link: range gate, thinning, deskewing.

Coordinates are kept in rows, (3, N): NumPy works several times as fast along them.
"""

from dataclasses import dataclass, field
from typing import Protocol

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.measurements import LidarScan
from incremental_mapper.voxels import means_within, voxel_means


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A thinned scan in base_link; each point is where it was seen when it was fired.

    ``rows`` (3, N) are x, y, z in metres; ``times`` (N,) are seconds after the stamp, None where
    they are not known or not wanted; ``intensities`` (N,), None where there are none. ``middle``
    are seconds from the stamp to the middle of the sweep, 0 without times.
    """

    stamp: int
    sensor: str
    rows: NDArray[np.float64]
    times: NDArray[np.float64] | None = None
    intensities: NDArray[np.float64] | None = None
    middle: float = field(init=False)

    def __post_init__(self) -> None:
        times = self.times
        middle = 0.0 if times is None or len(self) == 0 else float(times.mean())
        object.__setattr__(self, 'middle', middle)  # asked for a dozen times a scan

    def __len__(self) -> int:
        return int(self.rows.shape[1])


class BodyMotion(Protocol):
    """How base_link moves around a sweep; moments are seconds after its stamp."""

    def between(self, start: float, end: float) -> gtsam.Pose3:
        """T_start_end."""

    def moved(
        self, rows: NDArray[np.float64], times: NDArray[np.float64], moment: float
    ) -> NDArray[np.float64]:
        """Points (3, N) seen at ``times`` (N,), as base_link would have seen them at a moment."""


@dataclass(frozen=True, slots=True, eq=False)
class Twist:
    """Constant motion of base_link: ``linear`` (3,) m/s and ``angular`` (3,) rad/s, body frame."""

    linear: NDArray[np.float64]
    angular: NDArray[np.float64]

    def over(self, seconds: float) -> gtsam.Pose3:
        """The motion within so many seconds."""
        return gtsam.Pose3.Expmap(np.concatenate([self.angular, self.linear]) * seconds)

    def between(self, start: float, end: float) -> gtsam.Pose3:
        """See BodyMotion."""
        return self.over(end - start)

    def moved(
        self, rows: NDArray[np.float64], times: NDArray[np.float64], moment: float
    ) -> NDArray[np.float64]:
        """See BodyMotion."""
        since = times - moment
        # Rodrigues: p + sin(at)/a (w x p) + (1 - cos(at))/a^2 (w x (w x p)), also where a is zero.
        cross = gtsam.Rot3.Hat(self.angular)
        half = float(np.linalg.norm(self.angular)) / (2.0 * np.pi)
        once = since * np.sinc(2.0 * half * since)
        twice = 0.5 * (since * np.sinc(half * since)) ** 2
        moved = rows + once * (cross @ rows) + twice * (cross @ cross @ rows)
        moved += since * self.linear[:, None]
        return moved


STANDING = Twist(np.zeros(3), np.zeros(3))


def to_base(
    scan: LidarScan,
    T_base_lidar: NDArray[np.float64],
    min_range: float,
    max_range: float,
    voxel_size: float,
    with_times: bool = True,
) -> Sweep:
    """Move a scan into base_link and thin it; ranges, in metres, are from the LiDAR.

    A thinned point has the mean time and intensity of the points that it stands for. Deskewing is
    linear in the points and, within a voxel, in their times, so it is deskewed to their mean.
    """
    times = scan.point_times if with_times else None
    known = [values for values in (times, scan.intensities) if values is not None]
    further = np.array(known, dtype=np.float32).reshape(len(known), len(scan.points))
    # A float32 resolves 80 m to 8 um, the sensor resolves 2 mm.
    matrix = T_base_lidar.astype(np.float32)
    means = means_within(scan.points, further, matrix, (min_range, max_range), voxel_size)
    return Sweep(
        scan.stamp,
        scan.sensor,
        means[:3],
        None if times is None else means[3],
        None if scan.intensities is None else means[-1],
    )


def deskew(sweep: Sweep, motion: BodyMotion, moment: float) -> NDArray[np.float64]:
    """The points (N, 3) as base_link would have seen them ``moment`` seconds after the stamp.

    A sweep without times stays as it is.
    """
    if sweep.times is None:
        return sweep.rows.T
    return motion.moved(sweep.rows, sweep.times, moment).T


def warm_up() -> None:
    """Compile the kernels, or load them from disk."""
    point = np.ones((1, 3), dtype=np.float32)
    sweep = to_base(LidarScan(0, '', point), np.eye(4), 0.0, 10.0, 1.0)
    voxel_means(sweep.rows, 1.0)
