"""A look at an input: the shape of its LiDARs, where to start from, what is suspicious."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_edits import keep_stamps

from incremental_mapper.checks.finding import Severity
from incremental_mapper.config import Config
from incremental_mapper.datasets.open import open_source
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.measurements import make_scan
from incremental_mapper.results.lidar_shape import LidarShape, lidar_shape
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.starting_point import starting_point
from incremental_mapper.results.survey import BRIEF, THOROUGH, look_at, survey
from incremental_mapper.settings import merge, read_yaml

CONFIG = Path(__file__).parents[2] / 'config'
CAR = LidarShape(28_000, 16, 2.5, 60.0, 1.0, 0.0, 1.8, False)


def sweep(beams, spread=30.0, rays=900):
    """A LiDAR in the middle of a round hall of 20 m with a floor 1.8 m below it."""
    azimuth = np.linspace(-np.pi, np.pi, rays, endpoint=False)
    elevation = np.radians(np.linspace(-spread / 2.0, spread / 2.0, beams))
    a, e = (part.ravel() for part in np.meshgrid(azimuth, elevation))
    ground = np.where(e < 0.0, 1.8 / np.maximum(np.sin(-e), 1e-9), np.inf)
    ranges = np.minimum(20.0 / np.cos(e), ground)
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    return make_scan(1, 'lidar', ranges[:, None] * rays)


@pytest.mark.parametrize('beams', [16, 32, 64, 128])
def test_beams_are_counted(beams):
    shape = lidar_shape([sweep(beams)], np.eye(4))
    assert shape is not None
    assert shape.beams == beams
    assert shape.turn == 1.0
    assert shape.height == pytest.approx(1.8, abs=0.05)


def test_a_tilted_lidar_has_its_tilt_and_no_height():
    turn = pose_matrix([0.0, 0.0, 1.9, 0.0, np.sin(np.pi / 8), 0.0, np.cos(np.pi / 8)])
    shape = lidar_shape([sweep(16)], turn)
    assert shape is not None
    assert shape.tilt == pytest.approx(45.0)
    assert shape.height is None


def test_no_scans_have_no_shape():
    assert lidar_shape([], np.eye(4)) is None


ONE_OF_EACH = {
    'tilted': ({'left': LidarShape(28_000, 16, 2.5, 60.0, 1.0, 45.0, None, False)}, 0.0),
    'single': ({'lidar': CAR}, 100.0),
    'dense': ({'lidar': LidarShape(110_000, 64, 2.5, 70.0, 1.0, 0.0, 1.8, True)}, 0.0),
    'low': ({'lidar': LidarShape(17_000, 16, 1.0, 60.0, 1.0, 0.0, 0.9, True)}, 0.0),
}


@pytest.mark.parametrize('case', ONE_OF_EACH)
def test_a_starting_point_is_what_the_shipped_file_has(case):
    shapes, rate = ONE_OF_EACH[case]
    choices = starting_point(shapes, rate)
    assert choices
    for choice in choices:
        shipped = read_yaml(CONFIG.parent / choice.file)
        assert merge(shipped, choice.tree()) == shipped


def test_level_lidars_of_a_car_start_from_the_defaults():
    assert starting_point({'front': CAR, 'rear': CAR}, 100.0) == ()
    assert (
        starting_point({'only': CAR}, 10.0) == ()
    )  # an IMU too slow for longer windows than usual
    assert starting_point({}, 100.0) == ()


def test_large_scans_are_matched_in_processes_where_there_are_cores():
    (choice,) = starting_point({'front': CAR, 'rear': CAR}, 100.0, cores=2)
    assert choice.tree() == {'odometry': {'processes': True}}
    assert choice.text == 'odometry.processes: true'
    assert starting_point({'front': replace(CAR, points=2_000)}, 10.0, cores=2) == ()


def test_shipped_files_hold_nothing_that_is_a_default():
    """But for the paper's choices, which are named whatever the defaults are."""
    default = Config().model_dump(mode='json')
    for name in ('kaist', 'kitti', 's3e'):
        tree = read_yaml(CONFIG / f'{name}.yaml')
        for section in tree.keys() - {'lidars', 'imu', 'gnss'}:
            for key, value in tree[section].items():
                assert value != default[section][key], f'{name}: {section}.{key}'


def test_a_sound_drive_has_no_findings(light_bag, light_drive):
    for path in (light_bag, light_drive):
        seen = look_at(path, {}, 'settings')
        assert seen.findings == ()
        assert seen.truth
        assert [choice.place for choice in seen.start] == ['odometry.match_range']


def test_a_brief_look_chooses_as_a_thorough_one_does(light_bag):
    source = open_source(light_bag)
    brief = survey(source, Config(), BRIEF, match=False)
    assert brief.settings() == survey(source, Config(), THOROUGH).settings()


def test_a_drive_without_settings_starts_from_the_look(light_bag):
    drive = open_drive(light_bag, {'selection': {'strategy': 'base'}}, 'settings')
    assert drive.config.odometry.match_range == 45.0
    assert drive.config.selection.strategy == 'base'
    (note,) = drive.notes
    assert 'odometry.match_range: 45.0' in note and 'config/kaist.yaml' in note


def test_settings_of_the_user_are_all_that_counts(light_bag):
    drive = open_drive(light_bag, {'odometry': {'voxel_size': 0.6}}, 'settings')
    assert drive.config.odometry.match_range == Config().odometry.match_range
    assert drive.notes == ()


def test_a_hole_is_found(light_copy):
    keep_stamps(light_copy, 'left', lambda i: i < 5 or i >= 18)
    found = [item for item in look_at(light_copy, {}, 'settings').findings if item.sensor == 'left']
    assert [(item.rule, item.severity) for item in found] == [('silent_sensor', Severity.WARNING)]
