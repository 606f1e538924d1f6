"""This mapper in evalio, beside the pipelines that it ships, and inputs as its data sets.

    EVALIO_CUSTOM=incremental_mapper.evaluation.evalio_module
    EVALIO_MAPPER_INPUTS=drive=path/to/drive:kitti=path/to/bag=settings.yaml

evalio knows one LiDAR and one IMU, whose frame is the base, and no fixes. Its sweeps are organised:
rows by elevation, columns by azimuth, which is guessed for inputs that do not say.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from evalio._cpp.helpers import (  # what its own loaders use: points one by one take a second
    DataType,
    Field,
    PointCloudMetadata,
    fill_col_row_major,
    pc2_to_evalio,
)
from evalio.datasets import Dataset, DatasetIterator
from evalio.types import (
    SE3,
    ImuMeasurement,
    ImuParams,
    LidarMeasurement,
    LidarParams,
    Trajectory,
)

from incremental_mapper.config import Config
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.source import Source
from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.evalio_pipeline import IncrementalMapper, stamp_of
from incremental_mapper.measurements import NANOSECONDS, ImuSample, LidarScan
from incremental_mapper.results.lidar_shape import lidar_shape
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import read_yaml

__all__ = ['IncrementalMapper', 'MapperInputs']  # evalio looks for both in this module

INPUTS = 'EVALIO_MAPPER_INPUTS'
"""Environment variable with the inputs, NAME=PATH or NAME=PATH=SETTINGS, separated as in PATH."""
COLUMNS = 1800
Place: TypeAlias = tuple[Path, Path | None]
"""An input, and a file of settings for it."""
LOOKED_AT = 5
"""Scans that tell how a LiDAR is made."""

_POINT = {'x': '<f4', 'y': '<f4', 'z': '<f4', 't': '<u4', 'range': '<u4', 'row': '<u2'}
_CELL = np.dtype(list(_POINT.items()))
_KINDS = {'<f4': DataType.FLOAT32, '<u4': DataType.UINT32, '<u2': DataType.UINT16}
_OFFSETS = np.cumsum([0, *(np.dtype(kind).itemsize for kind in _POINT.values())]).tolist()
_FIELDS = [
    Field(name=name, datatype=_KINDS[kind], offset=offset)
    for (name, kind), offset in zip(_POINT.items(), _OFFSETS, strict=False)
]


@dataclass(frozen=True, slots=True, eq=False)
class Opened:
    """An input with its settings; ``rows`` and ``rate`` are the beams and sweeps of its LiDAR."""

    source: Source
    config: Config
    lidar: str
    rows: int
    rate: float


class _Measurements(DatasetIterator):  # type: ignore[misc]
    """An input as evalio goes through it."""

    def __init__(self, sequence: '_Sequence') -> None:
        self._sequence = sequence

    def imu_iter(self) -> Iterator[ImuMeasurement]:
        """The samples alone."""
        return (item for item in self if isinstance(item, ImuMeasurement))

    def lidar_iter(self) -> Iterator[LidarMeasurement]:
        """The sweeps alone."""
        return (item for item in self if isinstance(item, LidarMeasurement))

    def __iter__(self) -> Iterator[Any]:
        """All of them in the order of the input."""
        opened = _opened(self._sequence.place)
        turn = opened.config.imu.matrix()[:3, :3]  # samples go along the axes of base_link
        for item in opened.source.measurements():
            if isinstance(item, ImuSample):
                stamp = stamp_of(item.stamp)
                yield ImuMeasurement(stamp, turn @ item.gyro, turn @ item.acceleration)
            elif isinstance(item, LidarScan) and item.sensor == opened.lidar:
                yield organised(item, opened.rows)

    def __len__(self) -> int:
        """Number of sweeps."""
        opened = _opened(self._sequence.place)
        return int(opened.source.info.counts[opened.lidar])


class _Sequence(Dataset):  # type: ignore[misc]
    """What all inputs have in common; the values of its members are their names."""

    @property
    def place(self) -> Place:
        """Where the input is, and a file of settings that tell where its sensors are."""
        return _places()[self.value]

    def data_iter(self) -> DatasetIterator:
        """Its measurements."""
        return _Measurements(self)

    def ground_truth_raw(self) -> Trajectory | None:
        """The true poses of base_link."""
        truth = _opened(self.place).source.truth()
        if truth is None:
            return None
        poses = [SE3.from_mat(pose) for pose in truth.matrices()]
        return Trajectory(stamps=[stamp_of(int(stamp)) for stamp in truth.stamps], poses=poses)

    def imu_T_lidar(self) -> SE3:  # noqa: N802 (evalio's name)
        """Where the LiDAR is on base_link, along whose axes the samples are."""
        opened = _opened(self.place)
        return SE3.from_mat(opened.config.lidars[opened.lidar].matrix())

    def imu_T_gt(self) -> SE3:  # noqa: N802 (evalio's name)
        """The truth is of base_link."""
        return SE3.identity()

    def imu_params(self) -> ImuParams:
        """The noise of the default settings; gravity as evalio's data sets with z up have it."""
        noise = Config().preintegration
        return ImuParams(
            gyro=noise.gyroscope_noise,
            accel=noise.accelerometer_noise,
            gyro_bias=noise.gyroscope_bias_walk,
            accel_bias=noise.accelerometer_bias_walk,
            gravity=np.array([0.0, 0.0, -noise.gravity]),
            rate=100.0,
        )

    def lidar_params(self) -> LidarParams:
        """How its sweeps are organised."""
        opened = _opened(self.place)
        return LidarParams(
            num_rows=opened.rows,
            num_columns=COLUMNS,
            min_range=1.0,
            max_range=100.0,
            rate=opened.rate,
        )

    def files(self) -> list[Path]:
        """The input itself."""
        return [self.place[0]]

    @classmethod
    def dataset_name(cls) -> str:
        """The first part of the names of all inputs."""
        # evalio finds this class as well as the one with members.
        return 'mapper_inputs' if cls.__members__ else 'mapper_inputs_base'


def _places() -> dict[str, Place]:
    """Inputs by name."""
    found: dict[str, Place] = {}
    for word in filter(None, os.environ.get(INPUTS, '').split(os.pathsep)):
        name, path, *settings = word.split('=')
        found[name] = Path(path).absolute(), Path(settings[0]).absolute() if settings else None
    return found


MapperInputs: Any = (
    _Sequence('MapperInputs', {name: name for name in _places()}) if _places() else None
)
"""The data set of the inputs that the environment names."""


def organised(scan: LidarScan, rows: int) -> LidarMeasurement:
    """A sweep as evalio has them: row by row, at the stamp of its first point.

    Args:
        scan: A sweep; of two points in one cell the nearer one stays.
        rows: Number of beams.
    """
    points = scan.points.astype(np.float64)
    times = np.zeros(len(points)) if scan.point_times is None else scan.point_times
    first = float(times.min(initial=0.0))
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    low, high = np.quantile(elevation, [0.001, 0.999])
    share = np.clip((elevation - low) / max(high - low, 1e-6), 0.0, 1.0)
    row = np.round(share * (rows - 1)).astype(int)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    column = ((np.pi - azimuth) / (2.0 * np.pi) * COLUMNS).astype(int) % COLUMNS
    ranges = np.linalg.norm(points, axis=1)
    order = np.argsort(-ranges)
    cells = (row * COLUMNS + column)[order]
    table = np.zeros(rows * COLUMNS, dtype=_CELL)
    for axis, name in enumerate('xyz'):
        table[name][cells] = points[order, axis]
    table['t'][cells] = np.round((times[order] - first) * NANOSECONDS).astype(np.uint32)
    table['range'][cells] = (1000.0 * ranges[order]).astype(np.uint32)
    table['row'] = np.repeat(np.arange(rows), COLUMNS)
    cloud = PointCloudMetadata(
        stamp=stamp_of(scan.stamp + round(first * NANOSECONDS)),
        width=len(table),
        height=1,
        point_step=_CELL.itemsize,
        row_step=table.nbytes,
        is_bigendian=0,
        is_dense=1,
    )
    sweep = pc2_to_evalio(cloud, _FIELDS, table.tobytes())
    fill_col_row_major(sweep)
    return sweep


@cache
def _opened(place: Place) -> Opened:
    """An input as the data set needs it."""
    path, settings = place
    tree = {} if settings is None else read_yaml(settings)
    source = open_source(path, tree)
    lidars = effective_config(source, tree, 'evalio').lidars
    lidar = next((name for name in sorted(lidars) if source.info.counts.get(name)), None)
    if lidar is None:
        raise InputError(f'{path}: has no LiDAR that can be used')
    scans = []
    for item in source.measurements():
        if isinstance(item, LidarScan) and item.sensor == lidar:
            scans.append(item)
        if len(scans) == LOOKED_AT:
            break
    shape = lidar_shape(scans, lidars[lidar].matrix())
    span = (scans[-1].stamp - scans[0].stamp) / NANOSECONDS if len(scans) > 1 else 0.0
    rate = (len(scans) - 1) / span if span > 0.0 else 10.0
    config = effective_config(source, tree, 'evalio')
    return Opened(source, config, lidar, max(shape.beams if shape else 16, 16), rate)
