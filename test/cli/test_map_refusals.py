"""What ``map`` refuses: exit status 1 and one line that says what, where and the remedy."""

import os
import shutil

import pytest

IDENTITY = '[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]'
SHEARED = '[1, 0.2, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]'


def test_missing_input(run_map, tmp_path):
    run_map(tmp_path / 'none').assert_refused(str(tmp_path / 'none'), 'does not exist')


def test_file_that_is_no_bag(run_map, tmp_path):
    path = tmp_path / 'notes.txt'
    path.write_text('no bag')
    run_map(path).assert_refused(str(path), 'is no bag')


@pytest.mark.parametrize('suffix', ['mcap', 'db3', 'bag'])
def test_garbage_under_the_name_of_a_bag(run_map, tmp_path, suffix):
    path = tmp_path / f'garbage.{suffix}'
    path.write_bytes(bytes(range(256)) * 40)
    run_map(path).assert_refused(str(path), 'cannot be read as a bag')


def test_empty_bag_file(run_map, tmp_path):
    path = tmp_path / 'empty.mcap'
    path.touch()
    run_map(path).assert_refused(str(path), 'cannot be read as a bag')


def test_empty_folder(run_map, tmp_path):
    path = tmp_path / 'empty'
    path.mkdir()
    run_map(path).assert_refused(str(path), 'is empty')


def test_folder_of_something_else(run_map, tmp_path):
    path = tmp_path / 'photos'
    path.mkdir()
    (path / 'cat.jpg').touch()
    run_map(path).assert_refused(str(path), 'holds cat.jpg')


def test_missing_calibration(run_map, light_copy):
    path = light_copy / 'calibration' / 'Vehicle2RightVLP.txt'
    path.unlink()
    run_map(light_copy).assert_refused(str(path), 'does not exist')


def test_calibration_that_is_no_rotation(run_map, light_copy):
    path = light_copy / 'calibration' / 'Vehicle2LeftVLP.txt'
    path.write_text('R: 1 0.2 0 0 1 0 0 0 1\nT: 0 0 0\n')
    run_map(light_copy).assert_refused(str(path), 'no rotation')


def test_extrinsic_in_the_settings_that_is_no_rotation(run_map, light_drive, settings):
    config = settings(f'lidars:\n  left:\n    T_base_sensor: {SHEARED}\n')
    run_map(light_drive, '--config', config).assert_refused('lidars.left', 'no rotation')


def test_extrinsic_of_eleven_numbers(run_map, light_drive, settings):
    config = settings(f'imu:\n  T_base_sensor: {IDENTITY[:-4]}]\n')
    run_map(light_drive, '--config', config).assert_refused('imu.T_base_sensor', '11 numbers')


def test_unknown_setting_with_the_name_that_was_meant(run_map, light_drive, settings):
    config = settings('window:\n  duraton: 0.2\n')
    run_map(light_drive, '--config', config).assert_refused("did you mean 'duration'?")


def test_unknown_section_with_the_name_that_was_meant(run_map, light_drive, settings):
    config = settings('odometri:\n  voxel_size: 0.5\n')
    run_map(light_drive, '--config', config).assert_refused("did you mean 'odometry'?")


@pytest.mark.parametrize(
    ('text', 'name', 'value'),
    [
        ('window:\n  duration: 0\n', 'window.duration', '0'),
        ('window:\n  duration: .nan\n', 'window.duration', 'nan'),
        ('window:\n  duration: .inf\n', 'window.duration', 'inf'),
        ('odometry:\n  max_range: -1\n', 'odometry.max_range', '-1'),
        ('odometry:\n  sigma_rotation: 0\n', 'odometry.sigma_rotation', '0'),
        ('odometry:\n  method: icp\n', 'odometry.method', "'icp'"),
        ('mom:\n  radius: wide\n', 'mom.radius', "'wide'"),
        ('imu:\n  time_offset: 1.0e+10\n', 'imu.time_offset', '10000000000.0'),
        ('graph:\n  lag: null\n', 'graph.lag', 'None'),
    ],
)
def test_value_out_of_range(run_map, light_drive, settings, text, name, value):
    run_map(light_drive, '--config', settings(text)).assert_refused(f'{name} is {value}')


def test_range_that_holds_nothing(run_map, light_drive, settings):
    config = settings('odometry:\n  min_range: 90\n  max_range: 10\n')
    run_map(light_drive, '--config', config).assert_refused('min_range', 'max_range')


@pytest.mark.parametrize('text', ['- a list\n', 'just words', '{', 'window: 3\n', 'lidars: 3\n'])
def test_settings_that_are_no_sections(run_map, light_drive, settings, text):
    run_map(light_drive, '--config', settings(text)).assert_refused('settings.yaml')


def test_missing_settings_file(run_map, light_drive, tmp_path):
    config = tmp_path / 'none.yaml'
    run_map(light_drive, '--config', config).assert_refused(str(config), 'cannot be read')


def test_unknown_strategy_on_the_command_line(run_map, light_drive, capsys):
    with pytest.raises(SystemExit) as stopped:
        run_map(light_drive, '--strategy', 'best')
    assert stopped.value.code == 2
    assert "'best'" in capsys.readouterr().err


def test_unknown_strategy_in_the_settings(run_map, light_drive, settings):
    config = settings('selection:\n  strategy: best\n')
    run_map(light_drive, '--config', config).assert_refused('best', 'min_time_shift')


def test_lidar_that_the_folder_does_not_have(run_map, light_drive, settings):
    config = settings('lidars:\n  names: [front]\n')
    run_map(light_drive, '--config', config).assert_refused("'front'", 'left and right')


def test_topic_that_the_bag_does_not_have(run_map, light_bag, settings):
    config = settings('lidars:\n  names: [front]\n  front:\n    topic: /front\n')
    run_map(light_bag, '--config', config).assert_refused(
        "'/front'", '/points_left', '/points_right', '/imu', '/fix'
    )


def test_topic_of_the_wrong_type(run_map, light_bag, settings):
    config = settings('imu:\n  topic: /fix\n')
    run_map(light_bag, '--config', config).assert_refused("'/fix'", 'sensor_msgs/msg/NavSatFix')


@pytest.mark.parametrize('text', ['', 'hello\n', '1 2 3\n', '1.0 0 0 0 0 0 0 0\n', '1,2,3\n'])
def test_malformed_truth(run_map, light_drive, tmp_path, text):
    path = tmp_path / 'truth.tum'
    path.write_text(text)
    run_map(light_drive, '--truth', path).assert_refused(str(path))


def test_missing_truth(run_map, light_drive, tmp_path):
    run_map(light_drive, '--truth', tmp_path / 'none.tum').assert_refused('none.tum')


def test_output_folder_in_use(run_map, light_drive, tmp_path):
    out = tmp_path / 'used'
    out.mkdir()
    (out / 'mine.txt').write_text('mine')
    run = run_map(light_drive, out=out)
    run.assert_refused(str(out), '--force')
    assert run.names() == ['mine.txt']


def test_force_keeps_foreign_files(run_map, light_drive, tmp_path):
    out = tmp_path / 'used'
    (out / 'more').mkdir(parents=True)
    (out / 'mine.txt').write_text('mine')
    (out / 'more' / 'deep.txt').write_text('deep')
    (out / 'stats.json').write_text('old')
    run = run_map(light_drive, '--force', '--strategy', 'base', out=out)
    assert run.status == 0
    assert run.text('mine.txt') == 'mine' and run.text('more/deep.txt') == 'deep'
    assert run.stats['strategy'] == 'base'


def test_output_is_a_file(run_map, light_drive, tmp_path):
    path = tmp_path / 'file'
    path.write_text('mine')
    run_map(light_drive, '--force', out=path).assert_refused(str(path), 'is a file')
    assert path.read_text() == 'mine'


def test_output_below_a_file(run_map, light_drive, tmp_path):
    (tmp_path / 'file').write_text('mine')
    run_map(light_drive, out=tmp_path / 'file' / 'out').assert_refused('cannot be made')


@pytest.mark.skipif(os.geteuid() == 0, reason='nothing is read-only to root')
def test_output_below_a_read_only_folder(run_map, light_drive, tmp_path):
    parent = tmp_path / 'closed'
    parent.mkdir(mode=0o500)
    run_map(light_drive, out=parent / 'out').assert_refused('cannot be made')


def test_output_that_cannot_be_written(run_map, light_drive, tmp_path):
    out = tmp_path / 'out'
    (out / 'map.ply').mkdir(parents=True)
    run = run_map(light_drive, '--force', '--strategy', 'base', out=out)
    assert run.status == 1
    assert run.err.splitlines()[-1].startswith(f'incremental_mapper: {out / "map.ply"}: cannot be')
    assert 'Traceback' not in run.err


def test_only_gnss_in_a_folder(run_map, light_copy):
    for side in ('left', 'right'):
        shutil.rmtree(light_copy / 'sensor_data' / f'VLP_{side}')
    run_map(light_copy).assert_refused('no LiDAR scans')
