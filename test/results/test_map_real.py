"""Real recordings through the ``map`` command; they skip where the recordings are absent."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.trajectory import match_truth

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / 'shared' / 'data'
KITTI = DATA / 'kitti_0009'
KITTI_TRUTH = KITTI / 'ground_truth.tum'


def needs(folder):
    return pytest.mark.skipif(not folder.is_dir(), reason=f'{folder} is not there')


@pytest.fixture(scope='module')
def keep():
    """The run that several tests look at."""
    return {}


@pytest.fixture
def kitti(run_map, keep, tmp_path_factory):
    """KITTI's drive with its settings file, mapped once."""
    if not keep:
        out = tmp_path_factory.mktemp('kitti') / 'out'
        options = ('--config', ROOT / 'config' / 'kitti.yaml', '--truth', KITTI_TRUTH)
        keep['run'] = run_map(KITTI, *options, out=out)
    return keep['run']


@needs(KITTI)
def test_kitti_is_mapped_without_a_loss(kitti):
    assert kitti.status == 0
    assert kitti.stats['components'] == 1
    assert kitti.stats['dropped'] == {}
    assert kitti.stats['notes'] == {}
    assert kitti.stats['vertices'] < kitti.stats['base_vertices']
    assert "field 'time' in s from the header stamp" in kitti.err


@needs(KITTI)
def test_kitti_errors_are_printed_and_small(kitti):
    stats = kitti.stats
    errors = (stats['rpe_per_second_translation_rmse_m'], stats['ate_rmse_m'])
    for text in (f'{error:.4f} m' for error in errors):
        assert text in kitti.out
    assert stats['ate_rmse_m'] < 0.066  # measured: 0.044 m
    # Course and heading of the truth differ from what the LiDAR sees by 1.4 degrees.
    assert stats['rpe_translation_rmse_m'] < 0.042  # measured: 0.028 m
    assert stats['rpe_per_second_translation_rmse_m'] < 0.36  # 0.241 m
    assert stats['rpe_rotation_rmse_deg'] < 0.09  # 0.057 deg


@needs(KITTI)
def test_kitti_map_is_east_north_up(kitti):
    estimate, truth = match_truth(kitti.trajectory, read_truth(KITTI_TRUTH))
    travelled = estimate.positions[-1] - estimate.positions[0]
    expected = truth.positions[-1] - truth.positions[0]
    assert np.linalg.norm(expected) > 40.0
    assert np.linalg.norm((travelled - expected)[:2]) < 0.5
    turn = (truth.rotations().inv() * estimate.rotations()).as_rotvec(degrees=True)
    assert np.abs(turn).max() < 4.0


@needs(KITTI)
def test_first_matches_of_a_moving_car_are_as_good_as_the_rest(kitti):
    """The first scan is not de-skewed, for nobody knows the motion yet; the second one is."""
    truth = read_truth(KITTI_TRUTH)
    errors = []
    for factor in kitti.factors('odometry'):
        stamps = np.array(factor['stamps_ns'])
        if truth.covers(stamps).all():
            first, second = truth.interpolate(stamps).matrices()
            motion = np.linalg.inv(first) @ second
            errors.append(np.linalg.norm(motion[:3, 3] - factor['T_first_second'][:3]))
    assert len(errors) >= 45
    assert max(errors[:6]) < 0.15, np.round(errors[:6], 2)


@needs(KITTI)
def test_settings_of_kitti_hold_the_calibration_of_the_recording():
    tree = yaml.safe_load((ROOT / 'config' / 'kitti.yaml').read_text())
    numbers = tree['/**']['ros__parameters']['lidars']['velodyne']['T_base_sensor']
    calibrated = np.loadtxt(KITTI / 'T_base_lidar.txt')[:3].ravel()
    np.testing.assert_allclose(numbers, calibrated, atol=1e-9)


@needs(DATA / 'kaist_urban30_left')
def test_kaist_scans_alone(run_map):
    run = run_map(DATA / 'kaist_urban30_left')
    assert run.status == 0
    assert 'no calibration' in run.err
    assert run.stats['clusters'] == 10
    assert run.stats['factors_by_kind'] == {'odometry': 9, 'prior_pose': 1}
    assert run.stats['components'] == 1


@needs(DATA / 's3e_playground_2')
@pytest.mark.parametrize('configured', [True, False])
def test_s3e_with_and_without_its_settings(run_map, configured):
    options = ('--config', ROOT / 'config' / 's3e.yaml') if configured else ()
    run = run_map(DATA / 's3e_playground_2', *options)
    assert run.status == 0
    counts = run.stats['input']['counts']
    assert counts.pop('velodyne' if configured else 'Alpha') == 2
    assert counts.pop('imu') == 14
    assert set(counts.values()) <= {0}
    assert run.stats['components'] == 1
    assert run.stats['factors_by_kind']['odometry'] == 1
