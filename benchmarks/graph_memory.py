"""What the pieces of a graph take in memory, measured in this process.

GTSAM does not tell what its factors take, so many of each are made and the growth of resident
memory is divided by their number. Names of pieces are the kinds of factors as in stats.json, and
``cluster``, ``window`` (its row of windows.csv) and ``scan`` (without its points).
"""

import gc
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from scipy.cluster.hierarchy import DisjointSet

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.config import Config
from incremental_mapper.errors import InputError
from incremental_mapper.frontend.imu_preintegration import preintegration_parameters
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    between_factor,
    gnss_factor,
    imu_factor,
)
from incremental_mapper.mapping.row_archive import RowArchive
from incremental_mapper.smoothing.graph_state import PlacedCluster, PlacedScan
from incremental_mapper.variables import bias_key, pose_key, velocity_key

MANY = 5000
SAMPLES = 6
"""IMU samples of a usual span."""
COLUMNS = 34
"""Columns of windows.csv."""
STAMP = 1_500_000_000_000_000_000


def children(process: int | str) -> list[int]:
    """Numbers of the processes that a process has started, whichever of its threads did so."""
    found: list[int] = []
    with suppress(OSError):  # threads and processes may end while they are looked at
        for task in Path(f'/proc/{process}/task').iterdir():
            with suppress(OSError):
                found += map(int, (task / 'children').read_text(encoding='ascii').split())
    return found


def resident(pid: int | str = 'self') -> int:
    """Bytes of memory that a process holds; raises InputError where it has ended."""
    try:
        for line in Path(f'/proc/{pid}/status').read_text().splitlines():
            if line.startswith('VmRSS:'):
                return 1024 * int(line.split()[1])
    except OSError:
        pass
    raise InputError('the program has ended')


NOISE = 0.01 * (np.eye(6) + 0.1)


def piece_sizes() -> dict[str, float]:
    """Bytes of each kind of piece."""
    config = Config()
    parameters = preintegration_parameters(config.preintegration, np.eye(4))

    def odometry(i: int) -> Factor:
        pose = gtsam.Pose3(gtsam.Rot3.Yaw(0.1), np.array([1.0, 2.0, i]))
        ends, stamps = (pose_key(i), pose_key(i + 1)), (STAMP + i, STAMP + i + 1)
        return between_factor(FactorKind.ODOMETRY, ends, pose, NOISE, 'left', stamps)

    def gnss(i: int) -> Factor:
        position = np.array([1.0, 2.0, i])
        return gnss_factor(pose_key(i), position, np.eye(3), np.zeros(3), 1.0, 'gnss', STAMP + i)

    def imu(i: int) -> Factor:
        span = gtsam.PreintegratedCombinedMeasurements(parameters, gtsam.imuBias.ConstantBias())
        for _ in range(SAMPLES):
            span.integrateMeasurement(np.array([0.0, 0.0, 9.8]), np.zeros(3), 0.01)
        stamps = np.arange(SAMPLES) + STAMP + i
        return imu_factor(i, i + 1, span, 'imu', (STAMP + i, STAMP + i + SAMPLES), stamps)

    values, components = gtsam.Values(), DisjointSet()

    def cluster(i: int) -> PlacedCluster:
        values.insert(pose_key(i), gtsam.Pose3())
        values.insert(velocity_key(i), np.zeros(3))
        values.insert(bias_key(i), gtsam.imuBias.ConstantBias())
        for key in (pose_key(i), velocity_key(i), bias_key(i)):
            components.add(key)
        members = (
            CoreMeasurement(STAMP + i, 'left', CoreKind.LIDAR),
            CoreMeasurement(STAMP + i + 1, 'right', CoreKind.LIDAR),
        )
        return PlacedCluster(i, i, Cluster(members))

    rows = RowArchive()

    def window(i: int) -> None:
        rows.add({name: 0.5 * i + column for column, name in enumerate(NAMES)})

    def scan(i: int) -> PlacedScan:
        points = np.ones((1, 3), dtype=np.float32)
        return PlacedScan(i, STAMP + i, 'left', points, gtsam.Pose3())

    makers = {
        'odometry': odometry,
        'gnss': gnss,
        'imu': imu,
        'cluster': cluster,
        'window': window,
        'scan': scan,
    }
    kept: list[Any] = []  # what is freed would make room for the next kind
    sizes: dict[str, float] = {}
    for name, make in makers.items():
        gc.collect()
        before = resident()
        kept += [make(i) for i in range(MANY)]
        sizes[name] = (resident() - before) / MANY
    return sizes


NAMES = [f'column_{index}' for index in range(COLUMNS)]


def graph_bytes(sizes: Mapping[str, float], stats: Mapping[str, Any]) -> float:
    """What the graph of ``stats`` (the keys of stats.json) takes, points of scans apart."""
    counts = {
        **stats['factors_by_kind'],
        'cluster': stats['clusters'],
        'window': stats['windows'],
        'scan': sum(n for name, n in stats['received'].items() if name not in ('imu', 'gnss')),
    }
    return sum(sizes.get(name, 0.0) * count for name, count in counts.items())
