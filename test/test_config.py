"""Settings: what is rejected, with which remedy, and the two layouts of the file."""

import pytest

from incremental_mapper.config import Config, Strategy
from incremental_mapper.errors import ConfigError
from incremental_mapper.settings import (
    load_config,
    make_config,
    merge,
    read_yaml,
    to_tree,
    write_ros_yaml,
)

PLAIN = """
lidars:
  names: [left, right]
  left: {topic: /points_left, T_base_sensor: [1.0, 0.5, 2.0, 0.0, 0.0, 0.0, 1.0]}
  right: {topic: /points_right}
imu: {topic: /imu, time_offset: 0.01}
window: {duration: 0.2}
selection: {strategy: min_time_shift}
"""


def in_ros_layout(text):
    body = ''.join(f'    {line}\n' for line in text.strip().splitlines())
    return f'/**:\n  ros__parameters:\n{body}'


def test_ros_layout_and_plain_layout_are_equal(tmp_path):
    plain, ros, named = (tmp_path / name for name in ('plain.yaml', 'ros.yaml', 'named.yaml'))
    plain.write_text(PLAIN)
    ros.write_text(in_ros_layout(PLAIN))
    named.write_text(in_ros_layout(PLAIN).replace('/**', 'incremental_mapper'))
    configs = [make_config(read_yaml(path)) for path in (plain, ros, named)]
    assert configs[0] == configs[1] == configs[2]
    assert configs[0].window.duration == 0.2
    assert list(configs[0].lidars) == ['left', 'right']
    assert configs[0].lidars['left'].matrix()[:3, 3].tolist() == [1.0, 0.5, 2.0]


def test_settings_survive_the_way_through_a_file(tmp_path):
    path = tmp_path / 'settings.yaml'
    config = make_config(
        {
            'lidars': {'names': ['roof'], 'roof': {'topic': '/points', 'time_offset': -0.05}},
            'gnss': {'T_base_sensor': [0.1, -0.2, 1.5, 0.0, 0.0, 0.6, 0.8]},
            'odometry': {'method': 'kiss_icp', 'voxel_size': 0.3},
            'mom': {'min_family_points': 7},
        }
    )
    write_ros_yaml(path, to_tree(config), 'made for a test\nin two lines')
    assert path.read_text().startswith('# made for a test\n# in two lines\n/**:')
    assert make_config(read_yaml(path)) == config


def test_defaults_survive_the_way_through_a_file(tmp_path):
    path = tmp_path / 'settings.yaml'
    write_ros_yaml(path, to_tree(Config()))
    assert make_config(read_yaml(path)) == Config()


@pytest.mark.parametrize(
    ('tree', 'message'),
    [
        ({'windows': {}}, r"windows is no setting; did you mean 'window'"),
        ({'window': {'duratoin': 1}}, r"window\.duratoin is no setting; did you mean 'duration'"),
        ({'mom': {'radios': 1}}, r"mom\.radios is no setting; did you mean 'radius'"),
        ({'imu': {'offset': 1}}, r"imu\.offset is no setting; did you mean 'time_offset'"),
        (
            {'lidars': {'left': {'topics': '/a'}}},
            r"lidars\.left\.topics is no setting; did you mean 'topic'",
        ),
        ({'window': {'zzzzzz': 1}}, r'zzzzzz is no setting; known names: duration, lateness'),
    ],
)
def test_unknown_name_is_rejected_with_the_closest_known_one(tree, message):
    with pytest.raises(ConfigError, match=message):
        make_config(tree)


@pytest.mark.parametrize(
    ('tree', 'name', 'value'),
    [
        ({'window': {'duration': 0.0}}, 'window.duration', '0.0'),
        ({'window': {'duration': float('nan')}}, 'window.duration', 'nan'),
        ({'window': {'lateness': -1}}, 'window.lateness', '-1'),
        ({'odometry': {'min_points': 3}}, 'odometry.min_points', '3'),
        ({'odometry': {'method': 'ndt'}}, 'odometry.method', "'ndt'"),
        ({'fixes': {'min_status': 5}}, 'fixes.min_status', '5'),
        ({'fixes': {'min_sigma': float('inf')}}, 'fixes.min_sigma', 'inf'),
        ({'mom': {'radius': 'wide'}}, 'mom.radius', "'wide'"),
        ({'selection': {'max_candidates': 0}}, 'selection.max_candidates', '0'),
        ({'imu': {'time_offset': 1e10}}, 'imu.time_offset', '10000000000.0'),
        ({'imu': {'time_offset': float('nan')}}, 'imu.time_offset', 'nan'),
    ],
)
def test_value_out_of_range_is_rejected_with_name_and_value(tree, name, value):
    with pytest.raises(ConfigError) as caught:
        make_config(tree, 'drive.yaml')
    assert f'drive.yaml: {name} is {value}' in str(caught.value)


@pytest.mark.parametrize('name', ['a\0b', '/', 'maps/..', 'm' * 201, f'/data/{"ä" * 101}/map'])
def test_a_folder_that_no_file_system_can_make_is_refused_before_there_is_a_map(name):
    with pytest.raises(ConfigError) as caught:
        make_config({'save': {'on_shutdown': name}})
    assert 'save.on_shutdown' in str(caught.value)
    assert make_config({'save': {'on_shutdown': 'm' * 200}}).save.on_shutdown


def test_every_wrong_setting_is_named_in_one_message():
    with pytest.raises(ConfigError) as caught:
        make_config({'window': {'duration': 9}, 'mom': {'radius': 0}})
    assert 'window.duration' in str(caught.value)
    assert 'mom.radius' in str(caught.value)


@pytest.mark.parametrize(
    ('numbers', 'message'),
    [
        ([0, 0, 0, 0, 0, 0, 2], 'quaternion has norm 2'),
        ([2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], 'no rotation'),
        ([-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], 'no rotation: determinant -1'),
        ([0, 0, 0], '3 numbers; expected 7'),
        ([float('nan'), 0, 0, 0, 0, 0, 1], 'finite'),
    ],
)
def test_extrinsic_that_is_no_rigid_transform_is_rejected(numbers, message):
    with pytest.raises(ConfigError, match=message):
        make_config({'imu': {'T_base_sensor': numbers}})


def test_extrinsic_may_be_a_row_major_matrix():
    config = make_config({'imu': {'T_base_sensor': [0, -1, 0, 1, 1, 0, 0, 2, 0, 0, 1, 3]}})
    assert config.imu.matrix().tolist() == [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]


def test_listed_lidar_without_a_section_has_the_defaults():
    config = make_config({'lidars': {'names': ['left', 'right'], 'right': {'topic': '/r'}}})
    assert config.lidars['left'].topic == ''
    assert config.lidars['right'].topic == '/r'


@pytest.mark.parametrize(
    ('lidars', 'message'),
    [
        ({'names': ['left'], 'rihgt': {}}, 'rihgt'),
        ({'names': 'left', 'left': {}}, 'expected a list'),
        ({'names': [1, 2]}, 'expected a list'),
    ],
)
def test_lidar_names_that_do_not_fit_their_sections_are_rejected(lidars, message):
    with pytest.raises(ConfigError, match=message):
        make_config({'lidars': lidars})


def test_settings_cannot_be_changed_after_they_were_checked():
    with pytest.raises(ValueError, match='frozen'):
        Config().window.duration = 5.0


def test_default_strategy_is_the_method_of_the_paper():
    assert Config().selection.strategy == Strategy.MOM


def test_higher_settings_win_in_every_section():
    low = {'window': {'duration': 0.1, 'lateness': 1.0}, 'mom': {'radius': 2.0}}
    high = {'window': {'duration': 0.3}, 'imu': {'topic': '/imu'}}
    assert merge(low, high) == {
        'window': {'duration': 0.3, 'lateness': 1.0},
        'mom': {'radius': 2.0},
        'imu': {'topic': '/imu'},
    }
    assert low['window'] == {'duration': 0.1, 'lateness': 1.0}


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('window: {duration: 0.1', 'is no YAML'),
        ('- a\n- b\n', 'holds list'),
        ('just a word', 'holds str'),
    ],
)
def test_file_that_holds_no_settings_is_rejected_by_name(tmp_path, text, message):
    path = tmp_path / 'broken.yaml'
    path.write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        read_yaml(path)
    assert str(path) in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'gone\.yaml: cannot be read'):
        read_yaml(tmp_path / 'gone.yaml')


@pytest.mark.parametrize('text', ['', '# only a comment\n', '/**:\n  ros__parameters:\n'])
def test_empty_file_means_the_defaults(tmp_path, text):
    path = tmp_path / 'empty.yaml'
    path.write_text(text)
    assert make_config(read_yaml(path)) == Config()


def test_a_file_that_is_no_settings_file_is_told_in_one_readable_line(tmp_path):
    path = tmp_path / 'map.yaml'
    path.write_text('image: a.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegate: 0\nfree: 1\nx: 2\n')
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    message = str(refused.value)
    assert message.startswith(f'{path}: is no settings file: image, resolution, origin, negate, fr')
    assert message.count('known names') == 1 and len(message) < 400


def test_known_names_of_a_section_are_told_once():
    with pytest.raises(ConfigError) as refused:
        make_config({'window': {'foo': 1, 'bar': 2}, 'graph': {'laag': 1.0}})
    message = str(refused.value)
    assert 'window.foo, window.bar are no settings; known names: duration' in message
    assert "graph.laag is no setting; did you mean 'lag'?" in message
    assert message.count('known names') == 1
