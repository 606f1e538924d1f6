"""Evidence on how LiDARs are turned of which nobody tells where they are."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.ground import GroundLook, see_ground
from incremental_mapper.checks.level_mount import level_mount
from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import ImuSample

FIRST = 40
"""Matches after which a LiDAR is looked at; then after twice as many, and so on."""
LAST = 400
"""Matches after which it is looked at no more."""
CLOUDS = 8
"""Clouds that are kept, one of every so many matches."""


@dataclass(slots=True)
class _Mount:
    """Evidence on one LiDAR."""

    moves: list[NDArray[np.float64]] = field(default_factory=list)
    clouds: list[NDArray[np.float32]] = field(default_factory=list)
    due: int = FIRST


class MountWatch:
    """Looks at the unplaced LiDARs of a map; costs nothing where there are none."""

    def __init__(self, config: Config) -> None:
        self._mounts = {
            name: _Mount()
            for name, lidar in config.lidars.items()
            if 'T_base_sensor' not in lidar.model_fields_set
        }
        self._imu_unplaced = 'T_base_sensor' not in config.imu.model_fields_set
        self._force = np.zeros(3)
        self.wanted = bool(self._mounts)
        """Whether there are any."""

    def sample(self, sample: ImuSample) -> None:
        """Take in the IMU's acceleration, where it is wanted."""
        if np.isfinite(sample.acceleration).all():
            self._force += sample.acceleration

    def matches(self, prepared: Sequence[Prepared]) -> list[Finding]:
        """Take in the matches of a window."""
        found = []
        for item in prepared if self._mounts else ():
            if not isinstance(item, PreparedScan) or item.T_previous_current is None:
                continue
            mount = self._mounts.get(item.core.sensor)
            if mount is None or len(mount.moves) >= LAST:
                continue
            if len(mount.moves) % CLOUDS == 0:
                mount.clouds.append(item.thinned[:, :3])
            mount.moves.append(item.T_previous_current.translation())
            if len(mount.moves) >= mount.due:
                mount.due *= 2
                found += self._look(item.core.sensor, mount)
        return found

    def end(self) -> list[Finding]:
        """Look once more: nothing more will come."""
        return [found for name, mount in self._mounts.items() for found in self._look(name, mount)]

    def _look(self, name: str, mount: _Mount) -> list[Finding]:
        if not mount.moves:
            return []
        ground = see_ground(GroundLook(name, np.zeros(3), mount.clouds[-CLOUDS:]))
        if ground is None:
            return []
        force = self._force if self._force.any() else None
        found = level_mount(ground, np.array(mount.moves), force, self._imu_unplaced)
        return [] if found is None else [found]
