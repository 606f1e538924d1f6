"""From a raw scan to points in base_link: range gate, deskewing, thinning."""

from dataclasses import dataclass

import gtsam
import numpy as np
import small_gicp
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.geometry import transform_points
from incremental_mapper.measurements import LidarScan


@dataclass(frozen=True, slots=True, eq=False)
class BaseScan:
    """A scan in base_link ``moment`` seconds after its stamp.

    ``points`` (N, 3) and ``thinned`` (M, 3) are in metres.
    """

    stamp: int
    sensor: str
    points: NDArray[np.float64]
    thinned: NDArray[np.float64]
    moment: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Twist:
    """Constant motion of base_link: ``linear`` (3,) m/s and ``angular`` (3,) rad/s, body frame."""

    linear: NDArray[np.float64]
    angular: NDArray[np.float64]

    def over(self, seconds: float) -> gtsam.Pose3:
        """The motion within so many seconds."""
        return gtsam.Pose3.Expmap(np.concatenate([self.angular, self.linear]) * seconds)


STANDING = Twist(np.zeros(3), np.zeros(3))


def to_base(
    scan: LidarScan,
    T_base_lidar: NDArray[np.float64],
    min_range: float,
    max_range: float,
    voxel_size: float,
    twist: Twist | None,
    at_stamp: bool = True,
) -> BaseScan:
    """Move a scan into base_link and thin it; ranges in metres from the LiDAR.

    Where the scan has per-point times and a ``twist`` is given, each point is moved to where
    base_link saw it at the scan's stamp, or else at the middle of the sweep: there an error of
    the twist blurs the cloud but does not shift it.
    """
    ranges = np.linalg.norm(scan.points.astype(np.float64), axis=1)
    keep = (ranges >= min_range) & (ranges <= max_range)
    points = transform_points(T_base_lidar, scan.points[keep].astype(np.float64))
    moment = 0.0
    if twist is not None and scan.point_times is not None and len(points):
        times = scan.point_times[keep].astype(np.float64)[:, None]
        moment = 0.0 if at_stamp else float(times.mean())
        times -= moment
        points = Rotation.from_rotvec(times * twist.angular).apply(points) + times * twist.linear
    return BaseScan(scan.stamp, scan.sensor, points, thin(points, voxel_size), moment)


def thin(points: NDArray[np.float64], voxel_size: float) -> NDArray[np.float64]:
    """One mean point per voxel, (M, 3)."""
    if len(points) == 0:
        return points
    thinned: NDArray[np.float64] = small_gicp.voxelgrid_sampling(points, voxel_size).points()
    return thinned[:, :3]
