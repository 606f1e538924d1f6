"""``check``: what it prints, how it ends, and the settings that it writes."""

import shutil
from pathlib import Path

import pytest
import yaml
from bag_files import CLOUD, IMU, write_bag
from drive_edits import keep_stamps

from incremental_mapper.cli.main import main
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import load_config, to_tree


@pytest.fixture
def check(capsys):
    """Run ``check`` in this process; returns exit status, stdout and stderr."""

    def run(*words):
        capsys.readouterr()
        status = main(['check', *map(str, words)])
        printed = capsys.readouterr()
        return status, printed.out, printed.err

    return run


def test_a_sound_bag(check, light_bag):
    status, out, err = check(light_bag)
    assert status == 0
    assert err == 'nothing suspicious was found\n'
    lines = out.splitlines()
    assert lines[0].startswith(f'{light_bag}: ROS 2 bag, 3.')
    table = lines[2:7]
    assert [line.split()[0] for line in table] == ['sensor', 'left', 'right', 'imu', 'gnss']
    for title in ('topic', 'frame', 'T_base_sensor from'):  # to the left, so that columns begin so
        column = table[0].index(title)
        assert all(line[column - 1] == ' ' != line[column] for line in table[1:])
    for word in ('/points_left', '10', '100 Hz', '+0.000 s', 'left_lidar', SETTINGS_FILE):
        assert word in out
    assert 'about 16 beams' in out and 'tilted by 45 degrees' in out
    assert 'along +z of base_link' in out
    assert 'looked at are usable; status' in out
    assert 'truth  /ground_truth/odometry' in out
    assert 'odometry.match_range: 45.0' in out


def test_a_folder_has_no_column_of_topics_or_clocks(check, light_drive):
    status, out, _ = check(light_drive)
    assert status == 0
    assert 'topic' not in out.splitlines()[2] and 'record' not in out
    assert 'calibration/' in out


def test_what_cannot_be_mapped(check, tmp_path):
    bag = write_bag(tmp_path / 'bag', [('/imu', IMU, 0, 10, 40)])
    status, out, err = check(bag)
    assert status == 1
    assert out == ''
    assert len(err.splitlines()) == 1 and 'no LiDAR messages' in err


def test_one_sensor_is_enough(check, tmp_path):
    status, out, _ = check(write_bag(tmp_path / 'bag', [('/points', CLOUD, 0, 100, 8)]))
    assert status == 0
    assert ['imu', 'none'] in [line.split() for line in out.splitlines()]


def test_warnings_come_last_and_do_not_fail(check, light_copy):
    keep_stamps(light_copy, 'left', lambda i: i < 5 or i >= 18)
    status, _, err = check(light_copy)
    assert status == 0
    assert err.startswith('warning: left: nothing for ') and '(silent_sensor)' in err


def test_settings_that_are_checked(check, light_bag, settings):
    path = settings('imu:\n  topic: /nowhere\n')
    status, out, err = check(light_bag, '--config', path)
    assert status == 0
    assert 'missing_topic' in err
    assert 'imu' not in [line.split()[0] for line in out.splitlines()[2:6]]
    status, _, err = check(light_bag, '--config', settings('imu:\n  tpoic: /imu\n'))
    assert status == 1 and 'topic' in err


def test_a_file_is_not_replaced_unasked(check, light_bag, tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text('mine')
    status, out, err = check(light_bag, '--write', path)
    assert status == 1 and out == '' and 'use --force' in err
    assert path.read_text() == 'mine'
    assert check(light_bag, '--write', path, '--force')[0] == 0
    assert load_config(path).lidars.keys() == {'left', 'right'}
    status, _, err = check(light_bag, '--write', tmp_path)
    assert status == 1 and 'is a folder' in err


def test_every_line_of_the_file_says_where_it_comes_from(check, light_bag, tmp_path):
    path = tmp_path / 'mine.yaml'
    check(light_bag, '--write', path)
    lines = path.read_text().splitlines()
    values = [line for line in lines if ': ' in line and not line.startswith('#')]
    assert values and all('  # ' in line for line in values)
    tree = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    assert tree['lidars']['names'] == ['left', 'right']
    assert tree['imu']['topic'] == '/imu' and tree['imu']['time_offset'] == 0.0
    assert 'from incremental_mapper.yaml' in path.read_text()


def test_the_user_s_own_settings_stay(check, light_bag, tmp_path, settings):
    path = tmp_path / 'mine.yaml'
    own = settings('map:\n  voxel_size: 0.5\nodometry:\n  match_range: 60.0\n')
    check(light_bag, '--config', own, '--write', path)
    assert load_config(path).map.voxel_size == 0.5
    assert load_config(path).odometry.match_range == 60.0
    assert f'voxel_size: 0.5  # from {own}' in path.read_text()


@pytest.mark.parametrize('kind', ['bag', 'folder', 'unknown'])
def test_the_file_maps_as_no_file_does(check, run_map, light_bag, light_drive, tmp_path, kind):
    """Without the bag's own settings file too: then the LiDARs' extrinsics are not known."""
    source: Path = light_drive if kind == 'folder' else light_bag
    if kind == 'unknown':
        source = shutil.copytree(light_bag, tmp_path / 'bare')
        (source / SETTINGS_FILE).unlink()
    path = tmp_path / 'mine.yaml'
    check(source, '--write', path)
    words = ('--strategy', 'min_time_shift')
    plain = run_map(source, *words, out=tmp_path / 'plain')
    written = run_map(source, *words, '--config', path, out=tmp_path / 'written')
    assert plain.status == written.status
    if kind != 'folder':  # which has no topics
        assert written.stats['settings'] == plain.stats['settings']
    assert written.text('trajectory.tum') == plain.text('trajectory.tum')
    assert written.text('graph.json') == plain.text('graph.json')


def test_the_file_holds_what_was_in_force(check, light_bag, tmp_path):
    path = tmp_path / 'mine.yaml'
    check(light_bag, '--write', path)
    bare = effective_config(open_source(light_bag), {'odometry': {'match_range': 45.0}}, 'x')
    assert to_tree(load_config(path)) == to_tree(bare)
