"""A simulated spinning LiDAR, a VLP-16 unless told otherwise: rays against the scene's mesh.

Every column is fired at its own time.
"""

from types import ModuleType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.simulated.mesh import Mesh
from incremental_mapper.datasets.simulated.motion import Drive
from incremental_mapper.errors import InputError

Array = NDArray[np.float64]

SPIN = 2.0 * np.pi * 10.0
"""Angular speed of the head, rad/s."""
COLUMNS = 1320
"""Columns of a sweep, 0.27 degrees apart; so a scan has the 14 600 points of a KAIST one."""
TURN = 0.1
"""Seconds of a sweep."""
ELEVATIONS = np.radians([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
"""Elevations in the order in which the lasers of a column fire, radians."""
MAX_RANGE = 100.0
NOISE = 0.02
"""Standard deviation of a range in metres."""
RESOLUTION = 0.002
"""Ranges are whole multiples of this, metres."""
LOST = 0.01
"""Probability that an echo is lost, whatever it hit."""
ECHO = 30.0
"""Strength of the echo of a white wall at full range, in units of what is just detected."""


def load_embree() -> tuple[ModuleType, ModuleType]:
    """The ray caster's two modules; raises InputError where it is not installed."""
    try:
        from embreex import mesh_construction, rtcore_scene
    except ImportError as error:
        raise InputError(
            f'simulating LiDAR scans needs embreex, which cannot be imported ({error}); '
            'install it with: pip install "incremental_mapper[sim]"'
        ) from error
    return mesh_construction, rtcore_scene


class RayCaster:
    """Nearest hits of rays on a mesh."""

    def __init__(self, mesh: Mesh) -> None:
        mesh_construction, rtcore_scene = load_embree()
        self._reflectivity = mesh.reflectivity
        self._scene = rtcore_scene.EmbreeScene()
        # The scene does not keep its geometry alive, so this object does.
        self._geometry = mesh_construction.TriangleMesh(
            self._scene, mesh.vertices.astype(np.float32), mesh.faces
        )

    def cast(self, origins: Array, directions: Array) -> tuple[Array, Array, Array]:
        """Cast rays from ``origins`` (N, 3) in unit ``directions`` (N, 3).

        Returns for each ray the distance in metres (inf where nothing was hit), the cosine of
        the angle of incidence and the reflectivity.
        """
        hits = self._scene.run(
            origins.astype(np.float32), directions.astype(np.float32), output=True
        )
        face = hits['primID']
        normal = hits['Ng'].astype(np.float64)
        size = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        cosine = np.abs((normal * directions).sum(axis=1)) / size
        distance = np.where(face >= 0, hits['tfar'].astype(np.float64), np.inf)
        return distance, cosine, self._reflectivity[np.maximum(face, 0)]


class Lidar:
    """One LiDAR at ``T_base_lidar`` (4, 4) on the car.

    ``elevations`` (B,), radians, are those of its lasers, ``columns`` what a turn is cut into.
    """

    def __init__(
        self,
        caster: RayCaster,
        drive: Drive,
        T_base_lidar: Array,
        phase: float,
        elevations: Array = ELEVATIONS,
        columns: int = COLUMNS,
    ) -> None:
        self._elevations = elevations
        self._since_end = TURN / columns * np.arange(columns - 1.0, -1.0, -1.0)
        self._caster = caster
        self._drive = drive
        self._arm = T_base_lidar[:3, 3]
        self._turn = Rotation.from_matrix(T_base_lidar[:3, :3])
        self._phase = phase

    def sweep(self, end: float, rng: np.random.Generator) -> NDArray[np.float32]:
        """The sweep that ends at time ``end`` (s): x, y, z, reflectance (N, 4).

        See ``timed_sweep``.
        """
        return self.timed_sweep(end, rng)[0]

    def timed_sweep(
        self, end: float, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], Array]:
        """The sweep that ends at time ``end`` (s), and when its points (N,) were fired, seconds.

        A point is in the sensor's frame at the moment at which it was fired, so the motion of
        the car distorts the cloud. Points are in the order of firing. Nothing of the car itself
        is in the way.
        """
        times = end - self._since_end
        rays = self._rays(times)
        position, rotation = self._drive.poses(times)
        origins = position + rotation.apply(np.tile(self._arm, (len(times), 1)))
        matrices = (rotation * self._turn).as_matrix()
        directions = np.einsum('cij,crj->cri', matrices, rays).reshape(-1, 3)
        distance, cosine, reflectivity = self._caster.cast(
            np.repeat(origins, len(self._elevations), axis=0), directions
        )
        seen = distance < MAX_RANGE
        # Echoes at grazing angles and of dark, distant surfaces are too weak to be detected.
        fading = (MAX_RANGE / np.clip(distance, 1.0, MAX_RANGE)) ** 2
        strength = ECHO * reflectivity * cosine * fading
        chance = (1.0 - LOST) * -np.expm1(-strength)
        seen &= rng.random(len(distance)) < chance
        ranges = distance[seen] + rng.normal(scale=NOISE, size=int(seen.sum()))
        ranges = np.round(ranges / RESOLUTION) * RESOLUTION
        shine = 100.0 * reflectivity[seen] * np.sqrt(cosine[seen])
        reflectance = np.round(np.clip(shine + rng.normal(scale=2.0, size=len(shine)), 0.0, 255.0))
        points = rays.reshape(-1, 3)[seen] * ranges[:, None]
        fired = np.repeat(times, len(self._elevations))[seen]
        return np.column_stack([points, reflectance]).astype(np.float32), fired

    def _rays(self, times: Array) -> Array:
        """Unit directions (columns, lasers, 3) in the sensor's frame; the head turns clockwise."""
        azimuth = self._phase - SPIN * times
        level = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        rays = np.empty((len(times), len(self._elevations), 3))
        rays[..., :2] = level[:, None, :] * np.cos(self._elevations)[None, :, None]
        rays[..., 2] = np.sin(self._elevations)
        return rays
