"""Real recordings: a KITTI drive with point times, and a bag of the S3E data set."""

from pathlib import Path

import numpy as np
import pytest
from bag_files import count

from incremental_mapper.datasets.open import open_source
from incremental_mapper.measurements import GnssFix, ImuSample, LidarScan

DATA = Path(__file__).resolve().parents[3] / 'shared' / 'data'


def test_real_kitti_bag():
    path = DATA / 'kitti_0009'
    if not path.is_dir():
        pytest.skip(f'{path} is absent')
    source = open_source(path, {})
    assert source.info.counts == {'points': 51, 'imu': 568, 'gnss': 6}
    assert "LiDAR points: field 'time' in s from the header stamp" in source.info.notes
    measurements = list(source.measurements())
    assert source.drops == {} and len(measurements) == 625
    scan = next(m for m in measurements if isinstance(m, LidarScan))
    assert scan.points.shape == (122_320, 3)
    assert -0.11 < scan.point_times.min() < -0.09 and scan.point_times.max() <= 0.0
    assert next(m for m in measurements if isinstance(m, ImuSample)).orientation is None
    fix = next(m for m in measurements if isinstance(m, GnssFix))
    np.testing.assert_allclose(np.diag(fix.covariance), [0.0009, 0.0009, 0.0036])
    assert len(source.truth()) == 53


def test_real_s3e_bag():
    path = DATA / 's3e_playground_2'
    if not path.is_dir():
        pytest.skip(f'{path} is absent')
    source = open_source(path, {})
    assert count(source) == {'Alpha': 2, 'imu': 14}
    scan = next(m for m in source.measurements() if isinstance(m, LidarScan))
    assert len(scan.points) > 10_000
    assert 0.09 < np.ptp(scan.point_times) < 0.11
