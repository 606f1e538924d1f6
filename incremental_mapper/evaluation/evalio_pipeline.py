"""This mapper as a pipeline of evalio: it gets one LiDAR and one IMU, whose frame is the base."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from evalio.pipelines import Pipeline
from evalio.types import (
    SE3,
    ImuMeasurement,
    ImuParams,
    LidarMeasurement,
    LidarParams,
    Point,
    Stamp,
)
from numpy.typing import NDArray

from incremental_mapper import __version__
from incremental_mapper.config import Config, Tree
from incremental_mapper.mapping.beginning import Beginning
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.measurements import (
    NANOSECONDS,
    ImuSample,
    LidarScan,
    Measurement,
    make_imu,
    make_scan,
)
from incremental_mapper.results.mending import MOST_MENDS
from incremental_mapper.settings import make_config, merge, to_tree

LIDAR, IMU = 'lidar', 'imu'
CORES: Tree = {'odometry': {'processes': False}}
"""Others run in one process too."""


class IncrementalMapper(Pipeline):  # type: ignore[misc]
    """The mapper; parameters are all settings that are one value, by their dotted names."""

    def __init__(self) -> None:
        super().__init__()
        self._params: dict[str, Any] = {}
        self._sensors: Tree = {}
        self._mended: Tree = {}
        self._mends = 0
        self._mapper: Mapper | None = None
        self._beginning = Beginning()
        self._imu = False
        self._saved = 0

    @staticmethod
    def name() -> str:
        """Name of the pipeline."""
        return 'incremental_mapper'

    @staticmethod
    def version() -> str:
        """Version of this package."""
        return __version__

    @staticmethod
    def url() -> str:
        """Where it comes from."""
        return 'https://pypi.org/project/incremental-mapper'

    @staticmethod
    def default_params() -> dict[str, bool | int | float | str]:
        """All settings that are one value."""
        return flat_settings(to_tree(make_config(CORES, 'evalio')))

    def set_params(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Set some; returns those that are unknown.

        evalio hands over all of them, and what the data prove wrong is mended only where nobody
        has set it: what is as by default is taken for not set.
        """
        default = self.default_params()
        self._params |= {
            name: value for name, value in params.items() if default.get(name, value) != value
        }
        return {name: value for name, value in params.items() if name not in default}

    def set_imu_params(self, params: ImuParams) -> None:
        """Take over the noise of the IMU, where a data set tells it."""
        noise = {
            'accelerometer_noise': params.accel,
            'gyroscope_noise': params.gyro,
            'accelerometer_bias_walk': params.accel_bias,
            'gyroscope_bias_walk': params.gyro_bias,
        }
        # Nobody has measured what is as by default, so it may be mended.
        own = Config().preintegration
        told = {name: value for name, value in noise.items() if value != getattr(own, name)}
        self._sensors = merge(self._sensors, {'preintegration': told})

    def set_lidar_params(self, params: LidarParams) -> None:
        """Nothing depends on them."""

    def set_imu_T_lidar(self, T: SE3) -> None:  # noqa: N802, N803 (evalio's names)
        """Take over where the LiDAR is."""
        place = np.array(T.to_mat())[:3].ravel().tolist()
        lidars = {'names': [LIDAR], LIDAR: {'T_base_sensor': place}}
        identity = np.eye(4)[:3].ravel().tolist()
        self._sensors = merge(self._sensors, {'lidars': lidars, 'imu': {'T_base_sensor': identity}})

    def set_visualizing(self, visualize: Any) -> None:
        """Evalio's view shows the poses; for more there is ``map --view``."""

    def initialize(self) -> None:
        """Nothing is made before the parameters are known."""

    def map(self) -> dict[str, list[Point]]:
        """None is handed over."""
        return {}

    def add_imu(self, mm: ImuMeasurement) -> None:
        """Map a sample."""
        self._imu = True
        self._push(make_imu(nanoseconds_of(mm.stamp), IMU, np.array(mm.gyro), np.array(mm.accel)))

    def add_lidar(self, mm: LidarMeasurement) -> None:
        """Map a sweep."""
        points = np.array(mm.to_vec_positions(), dtype=np.float64).reshape(-1, 3)
        times = np.array(mm.to_vec_stamps(), dtype=np.float64)
        stamp = nanoseconds_of(mm.stamp)
        self._push(make_scan(stamp, LIDAR, points, times if np.ptp(times) > 0.0 else None))

    def _push(self, measurement: ImuSample | LidarScan) -> None:
        self._beginning.add(measurement)
        self._map(measurement)
        while again := self._anew():
            for one in again:
                self._map(one)

    def _anew(self) -> tuple[Measurement, ...]:
        """What is mapped again where the data prove a setting wrong, as ``map`` does it."""
        again, mapper = self._beginning.whole(), self._mapper
        if mapper is None or not mapper.mend or again is None or self._mends >= MOST_MENDS:
            return ()
        self._mended = merge(self._mended, mapper.mend)
        self._mends += 1
        mapper.close()
        self._mapper = None
        return again

    def _map(self, measurement: Measurement) -> None:
        if self._mapper is None:
            tree = merge(merge(CORES, nested_settings(self._params)), self._sensors)
            config = make_config(merge(tree, self._mended), 'evalio')
            self._mapper = Mapper(config, [LIDAR, IMU] if self._imu else [LIDAR])
        for window in self._mapper.push(measurement):
            self._save(self._mapper, window)

    def _save(self, mapper: Mapper, window: WindowResult) -> None:
        for placed, pose in zip(window.clusters, window.poses, strict=True):
            self._save_pose(placed.cluster.stamp, pose.matrix())
        if window.joined:
            # While the vehicle stands its newest pose holds at the end of each window.
            pose = mapper.state.pose(mapper.state.clusters[-1].id)
            self._save_pose(window.end, pose.matrix())

    def _save_pose(self, stamp: int, T_map_base: NDArray[np.float64]) -> None:
        """Hand a pose to evalio, which keeps all: those of a map begun anew follow the others."""
        if stamp > self._saved:
            self._saved = stamp
            self.save(stamp_of(stamp), SE3.from_mat(T_map_base))


def flat_settings(tree: Tree, before: str = '') -> dict[str, bool | int | float | str]:
    """Settings that are one value, by their dotted names.

    Args:
        tree: Nested settings.
        before: What stands before their names.
    """
    found: dict[str, bool | int | float | str] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            found |= flat_settings(dict(value), f'{before}{key}.') if key != 'lidars' else {}
        elif isinstance(value, (bool, int, float, str)):
            found[before + key] = value
    return found


def nested_settings(flat: Mapping[str, Any]) -> Tree:
    """Settings by dotted names as a settings file has them."""
    tree: Tree = {}
    for name, value in flat.items():
        for part in reversed(name.split('.')):
            value = {part: value}
        tree = merge(tree, value)
    return tree


def nanoseconds_of(stamp: Stamp) -> int:
    """A stamp of evalio in ns."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nsec)


def stamp_of(nanoseconds: int) -> Stamp:
    """A stamp in ns as evalio has it."""
    seconds, rest = divmod(nanoseconds, NANOSECONDS)
    return Stamp(sec=seconds, nsec=rest)
