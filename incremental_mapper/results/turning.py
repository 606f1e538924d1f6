"""Scans matched where the IMU turns most: some dozen, to hold the IMU against."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.imu_motion import FEWEST, MotionEvidence
from incremental_mapper.config import Config
from incremental_mapper.datasets.sampling import Sampled, SensorKind, SensorSample, scans_of
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.prepared_scan import PreparedScan, ScanPreparer
from incremental_mapper.measurements import ImuSample

POINTS = 1_500_000
"""Points that are matched in all: 1 s of work, 50 scans of a VLP-16 or 12 of an HDL-64."""
LEAST = FEWEST + 4
"""Scans that are matched however dense they are."""
MOST = 60


@dataclass(frozen=True, slots=True, eq=False)
class ImuSeries:
    """Samples of an IMU as its messages have them: stamps (K,) ns, rates and forces (K, 3)."""

    stamps: NDArray[np.int64]
    gyro: NDArray[np.float64]
    force: NDArray[np.float64]


def imu_series(sample: SensorSample) -> ImuSeries:
    """The usable samples of an IMU's sample, by stamp."""
    items = [item for item in sample.measurements if isinstance(item, ImuSample)]
    return ImuSeries(
        np.array([item.stamp for item in items], dtype=np.int64),
        np.array([item.gyro for item in items]).reshape(-1, 3),
        np.array([item.acceleration for item in items]).reshape(-1, 3),
    )


def turning(
    source: Sampled, samples: Sequence[SensorSample], config: Config
) -> MotionEvidence | None:
    """Match scans of the sparsest LiDAR in those blocks of the samples that turn most.

    Args:
        source: the input; the scans of these blocks are read.
        samples: what was read of each sensor.
        config: the settings in force.

    Returns:
        Rotations of scans and IMU; None where one of the two is missing.
    """
    imu = next((sample for sample in samples if sample.kind is SensorKind.IMU), None)
    sizes = {
        sample.sensor: float(np.mean([len(scan.points) for scan in scans_of(sample)]))
        for sample in samples
        if sample.kind is SensorKind.LIDAR and sample.measurements
    }
    if imu is None or not sizes or not config.imu.enabled:
        return None
    lidar = min(sizes, key=lambda name: sizes[name])
    count = int(np.clip(POINTS / max(sizes[lidar], 1.0), LEAST, MOST))
    matched = _matches(source, lidar, _blocks(imu), config, count)
    series = imu_series(imu)
    if len(matched) < FEWEST or len(series.stamps) < 2 * FEWEST:
        return None
    turn = config.imu.matrix()[:3, :3].T
    poses = [item.T_previous_current or gtsam.Pose3() for item in matched]
    return MotionEvidence(
        spans=np.array([(item.previous, item.core.stamp) for item in matched], dtype=np.int64),
        turns=np.array([gtsam.Rot3.Logmap(pose.rotation()) for pose in poses]),
        shifts=np.array([pose.translation() for pose in poses]),
        stamps=series.stamps,
        gyro=config.imu.rate_scale * series.gyro @ turn,
        force=config.imu.acceleration_scale * series.force @ turn,
        gravity=config.preintegration.gravity,
    )


def _blocks(imu: SensorSample) -> list[tuple[int, int]]:
    """Bounds of the blocks by time of recording, those in which the IMU turns most first."""
    series = imu_series(imu)
    spread: dict[tuple[int, int], float] = {}
    for block in np.unique(imu.blocks):
        inside = imu.blocks == block
        bounds = int(imu.received[inside].min()), int(imu.received[inside].max()) + 1
        stamps = imu.stamps[inside]
        within = (series.stamps >= stamps.min()) & (series.stamps <= stamps.max())
        if within.sum() > 2:
            spread[bounds] = float(series.gyro[within].std(axis=0).sum())
    return sorted(spread, key=lambda bounds: -spread[bounds])


def _matches(
    source: Sampled, lidar: str, blocks: Sequence[tuple[int, int]], config: Config, count: int
) -> list[PreparedScan]:
    """Matches of at most so many scans, block by block."""
    found: list[PreparedScan] = []
    preparer, block = ScanPreparer(lidar, config, Counter()), 0
    for number, scan in islice(source.scans(lidar, blocks), count):
        if number != block:
            preparer, block = ScanPreparer(lidar, config, Counter()), number
        try:
            prepared = preparer.prepare(scan)
        except MeasurementError:
            continue
        if prepared.previous is not None:
            found.append(prepared)
    return sorted(found, key=lambda item: item.core.stamp)
