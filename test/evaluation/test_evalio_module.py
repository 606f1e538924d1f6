"""In evalio: parameters are settings, sweeps keep points and times, and a drive gets poses."""

import numpy as np
import pytest

from incremental_mapper.errors import ConfigError

pytest.importorskip('evalio', reason='evalio is not installed (extra "evalio")')

from evalio.types import ImuMeasurement, ImuParams, LidarMeasurement, LidarParams

from incremental_mapper.config import Config
from incremental_mapper.datasets.open import open_source
from incremental_mapper.evaluation import evalio_module as module
from incremental_mapper.evaluation.evalio_pipeline import flat_settings, nested_settings
from incremental_mapper.measurements import LidarScan, make_scan
from incremental_mapper.trajectory import from_matrices, match_truth

SECOND = 1_000_000_000


@pytest.fixture
def sequence(light_drive, monkeypatch):
    monkeypatch.setenv(module.INPUTS, f'light={light_drive}')
    return module._Sequence('MapperInputs', {'light': 'light'}).light


def test_settings_are_the_same_there_and_back():
    tree = {'selection': {'strategy': 'base'}, 'odometry': {'match_range': 45.0}, 'lidars': {}}
    flat = flat_settings(tree)
    assert flat == {'selection.strategy': 'base', 'odometry.match_range': 45.0}
    assert nested_settings(flat) == {key: tree[key] for key in ('selection', 'odometry')}


def test_unknown_parameters_are_handed_back_and_wrong_ones_refused():
    pipeline = module.IncrementalMapper()
    assert pipeline.set_params({'selection.strategy': 'base', 'nonsense': 1}) == {'nonsense': 1}
    pipeline.set_params({'odometry.match_range': -1.0})
    with pytest.raises(ConfigError, match='match_range'):
        pipeline._push(make_scan(SECOND, 'lidar', np.ones((9, 3))))


def test_sweep_is_organised_and_begins_with_its_first_point():
    azimuth = np.radians([170.0, 10.0, -170.0])
    points = np.stack([5.0 * np.cos(azimuth), 5.0 * np.sin(azimuth), [0.5, 0.0, -0.5]], axis=1)
    scan = make_scan(7 * SECOND, 'left', points, np.array([-0.1, -0.05, 0.0]))
    sweep = module.organised(scan, 3)
    assert sweep.stamp.to_nsec() == pytest.approx(7 * SECOND - SECOND // 10, abs=100)
    assert len(sweep.points) == 3 * module.COLUMNS
    seen = [point for point in sweep.points if point.range > 0]
    assert [point.row for point in seen] == [0, 1, 2]
    assert [point.t.to_sec() for point in seen] == pytest.approx([0.1, 0.05, 0.0], abs=1e-7)
    assert np.allclose([[p.x, p.y, p.z] for p in seen], points[::-1], atol=1e-6)
    assert [point.col for point in seen] == sorted(point.col for point in seen)[::-1]


def test_input_as_a_data_set_has_all_sweeps_of_one_lidar_and_all_samples(light_drive, sequence):
    counts = open_source(light_drive, {}).info.counts
    items = list(sequence.data_iter())
    sweeps = [item for item in items if isinstance(item, LidarMeasurement)]
    samples = [item for item in items if isinstance(item, ImuMeasurement)]
    assert len(sweeps) == counts['left'] == len(sequence.data_iter())
    assert len(samples) == counts['imu']
    scan = next(
        item
        for item in open_source(light_drive, {}).measurements()
        if isinstance(item, LidarScan) and item.sensor == 'left'
    )
    seen = sum(point.range > 0 for point in sweeps[0].points)
    assert 0.9 * len(scan.points) < seen <= len(scan.points)


def test_drive_gets_poses_that_follow_the_truth(light_drive, sequence):
    pipeline = module.IncrementalMapper()
    pipeline.initialize()
    rest = pipeline.set_params({'odometry.match_range': 45.0, 'mom.max_points': 100})
    assert not rest
    assert isinstance(sequence.imu_params(), ImuParams)
    assert isinstance(sequence.lidar_params(), LidarParams)
    pipeline.set_imu_params(sequence.imu_params())
    pipeline.set_imu_T_lidar(sequence.imu_T_lidar())
    found = []
    for item in sequence.data_iter():
        if isinstance(item, ImuMeasurement):
            pipeline.add_imu(item)
        else:
            pipeline.add_lidar(item)
        found += pipeline.saved_estimates()
    stamps = np.array([stamp.to_nsec() for stamp, _ in found])
    poses = np.array([pose.to_mat() for _, pose in found])
    truth = open_source(light_drive, {}).truth()
    own, true = match_truth(from_matrices(stamps, poses), truth)
    assert len(found) > 15
    moved, driven = (np.linalg.norm(one.positions[-1] - one.positions[0]) for one in (own, true))
    assert driven > 3.0 and abs(moved - driven) < 0.1 * driven


def test_what_the_data_prove_wrong_is_mended_unless_it_was_chosen(sequence):
    def mapped(**chosen):
        pipeline = module.IncrementalMapper()
        quick = {'odometry.match_range': 45.0, 'mom.max_points': 100}
        pipeline.set_params(pipeline.default_params() | quick | chosen)  # as evalio does
        pipeline.set_imu_params(sequence.imu_params())
        pipeline.set_imu_T_lidar(sequence.imu_T_lidar())
        found, samples = [], 0
        for item in sequence.data_iter():
            if not isinstance(item, ImuMeasurement):
                pipeline.add_lidar(item)
            else:
                samples += 1
                if samples % 5 == 0:  # 20 Hz
                    pipeline.add_imu(item)
            found += [stamp.to_nsec() for stamp, _ in pipeline.saved_estimates()]
        return pipeline._mapper.config.preintegration, found

    usual = Config().preintegration
    noise, stamps = mapped()
    assert noise.accelerometer_noise > 2.0 * usual.accelerometer_noise
    assert len(stamps) > 15
    assert stamps == sorted(set(stamps))
    chosen = {'preintegration.accelerometer_noise': 0.011}
    assert mapped(**chosen)[0].accelerometer_noise == 0.011
