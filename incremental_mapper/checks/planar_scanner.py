"""Scanners whose beams lie in one plane: what they do not see of the vehicle's motion."""

from collections.abc import Sequence

import numpy as np

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.checks.ground import GroundLook

THIN = 0.02
"""Root mean square of the angles between the beams and their plane, radians. Of the lowest beam of
a VLP-16 alone it is 0.017, of scanners of one plane the noise, of all 16 beams 0.15; of the few
that reach a road from a roof 0.05 and more."""
FEWEST = 100
"""Points of a cloud that tell something."""


def planar_findings(looks: Sequence[GroundLook]) -> list[Finding]:
    """Say which LiDARs have all their beams in a plane.

    Args:
        looks: Clouds of each LiDAR.

    Returns:
        ``planar_scanner`` for each of them.
    """
    return [_planar(look.sensor) for look in looks if _is_planar(look)]


def _is_planar(look: GroundLook) -> bool:
    """Whether all clouds lie in a plane through the LiDAR."""
    clouds = [cloud - look.place for cloud in look.clouds if len(cloud) >= FEWEST]
    if not clouds:
        return False
    return all(_thickness(cloud.astype(np.float64)) < THIN for cloud in clouds)


def _thickness(points: np.ndarray[tuple[int, int], np.dtype[np.float64]]) -> float:
    """Root mean square angle of beams (N, 3) to the plane that fits them best."""
    beams = points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-9)
    moments = beams.T @ beams / len(beams)
    return float(np.sqrt(max(np.linalg.eigvalsh(moments)[0], 0.0)))


def _planar(sensor: str) -> Finding:
    return Finding(
        'planar_scanner',
        Severity.WARNING,
        sensor,
        'all its beams lie in one plane: it sees neither height nor roll nor pitch, which IMU and '
        'fixes alone hold, and where the vehicle rolls it takes that for a way aside',
        'take a LiDAR of several beams; for a planar scanner in a building a mapper of two '
        'dimensions, such as slam_toolbox',
    )
