"""The rules of ``checks``, asked of a sample: one line for each."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.checks.fix_sample import far_fixes, unusable_fixes
from incremental_mapper.checks.gaps import silences
from incremental_mapper.checks.imu_beside_lidar import check_motion
from incremental_mapper.checks.imu_gravity import check_gravity, measure_gravity
from incremental_mapper.checks.imu_motion import MotionEvidence
from incremental_mapper.config import Config
from incremental_mapper.datasets.remarks import Remarks
from incremental_mapper.datasets.sampling import SensorKind, SensorSample
from incremental_mapper.errors import MeasurementError
from incremental_mapper.measurements import GnssFix
from incremental_mapper.results.turning import imu_series

FURTHEST = 0.5
"""Seconds by which the IMU's clock may be off to be told from a sample: half a block. Beyond it
other matches are compared than at its own stamps, by chance alike on a straight drive (KAIST-like
constant speed, 1.1 s); while mapping all matches are there."""


def suspicions(
    samples: Sequence[SensorSample], config: Config, motion: MotionEvidence | None = None
) -> Iterator[Finding]:
    """Ask every rule that a sample can answer.

    Args:
        samples: what was read of each sensor.
        config: the settings in force.
        motion: what turned the IMU and what turned the scans, where some were matched.

    Yields:
        What is wrong, in no order.
    """
    remarks = Remarks()
    for sample in samples:
        for measurement in sample.measurements:
            remarks.take(measurement)
        if sample.kind is not SensorKind.GNSS:
            yield from silences(sample.sensor, sample.recorded)
        if sample.kind is SensorKind.GNSS:
            yield from _fixes(sample, config)
        if sample.kind is SensorKind.IMU and config.imu.enabled:
            yield from _gravity(sample, config)
    yield from remarks.findings()
    if motion is not None and config.imu.enabled:
        yield from (one for one in check_motion(motion, config.imu) if not _far_clock(one, config))


def _far_clock(finding: Finding, config: Config) -> bool:
    """Whether a clock is said to be further off than a sample can tell."""
    offset = finding.settings.get('imu', {}).get('time_offset', config.imu.time_offset)
    return bool(abs(offset - config.imu.time_offset) > FURTHEST)


def _fixes(sample: SensorSample, config: Config) -> Iterator[Finding]:
    """What the fixes show by themselves."""
    fixes = [item for item in sample.measurements if isinstance(item, GnssFix)]
    reasons, uncertain = Counter(sample.drops), []
    for fix in fixes:
        try:
            checked_covariance(fix, config.fixes)
        except MeasurementError as error:
            reasons[error.reason] += 1
            if fix.covariance is not None and error.reason == 'too_uncertain':
                uncertain.append(float(np.sqrt(fix.covariance[:2, :2].trace() / 2.0)))
    looked = len(fixes) + sum(sample.drops.values())
    largest = float(np.median(uncertain)) if uncertain else 0.0
    yield from unusable_fixes(sample.sensor, looked, reasons, largest)
    stamps = np.array([fix.stamp for fix in fixes], dtype=np.int64)
    places = np.array([(fix.latitude, fix.longitude) for fix in fixes]).reshape(-1, 2)
    yield from far_fixes(sample.sensor, stamps, places)


def _gravity(sample: SensorSample, config: Config) -> Iterator[Finding]:
    """What the IMU's accelerations say of their unit."""
    series = imu_series(sample)
    force = config.imu.acceleration_scale * series.force
    found = measure_gravity(series.stamps, force, config.imu.rate_scale * series.gyro)
    gravity = config.preintegration.gravity
    finding = None if found is None else check_gravity(found, config.imu, gravity)
    if finding is not None:
        yield finding
