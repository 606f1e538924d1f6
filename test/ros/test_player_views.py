"""The RViz2 configuration and the Foxglove layout show what the node publishes."""

import json
import re
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

needs_ros = pytest.mark.skipif(
    find_spec('rclpy') is None, reason='rclpy is not installed (extra "ros")'
)
CONFIG = Path(__file__).parents[2] / 'config'
NODE = '/incremental_mapper/'
LATCHED = {'map', 'path', 'graph', 'graph_stats'}
DISPLAYS = {
    'map': 'PointCloud2',
    'map_increment': 'PointCloud2',
    'path': 'Path',
    'odometry': 'Odometry',
    'poses': 'PoseArray',
    'graph': 'MarkerArray',
}
RVIZ_CLASSES = {
    'rviz_common': {'Displays', 'Time', 'Views'},
    'rviz_default_plugins': {
        *DISPLAYS.values(),
        *('FocusCamera', 'Grid', 'Measure', 'MoveCamera', 'Orbit', 'TF'),
    },
}
"""Those of RViz2 that a view may name, from rviz_default_plugins' plugins_description.xml."""


@pytest.fixture
def rviz():
    return yaml.safe_load((CONFIG / 'incremental_mapper.rviz').read_text())


@pytest.fixture
def layout():
    return json.loads((CONFIG / 'foxglove_layout.json').read_text())


def classes(branch):
    """Every class that a configuration names, wherever it stands."""
    if isinstance(branch, dict):
        own = [branch['Class']] if branch.get('Class') else []
        return own + [name for below in branch.values() for name in classes(below)]
    if isinstance(branch, list):
        return [name for below in branch for name in classes(below)]
    return []


def test_rviz_knows_every_class(rviz):
    named = classes(rviz)
    assert len(named) > 12
    for name in named:
        package, _, kind = name.partition('/')
        assert kind in RVIZ_CLASSES[package], name


def test_rviz_displays(rviz):
    rviz = rviz['Visualization Manager']
    assert rviz['Global Options']['Fixed Frame'] == 'map'
    shown = {d['Topic']['Value']: d for d in rviz['Displays'] if 'Topic' in d}
    assert {topic: display['Class'] for topic, display in shown.items()} == {
        NODE + name: f'rviz_default_plugins/{kind}' for name, kind in DISPLAYS.items()
    }
    for name in DISPLAYS:
        quality = shown[NODE + name]['Topic']
        durability = 'Transient Local' if name in LATCHED else 'Volatile'
        assert quality['Durability Policy'] == durability, name
        assert quality['Reliability Policy'] == 'Reliable'
        assert quality['Depth'] > 0


@needs_ros
def test_node_publishes_what_is_shown_with_the_quality_that_is_asked_for(start_node, layout):
    node = start_node().mapper.node
    published = dict(node.get_publisher_names_and_types_by_node('incremental_mapper', '/'))
    for name, kind in DISPLAYS.items():
        (found,) = published[NODE + name]
        assert found.split('/')[-1] == kind
        (offer,) = node.get_publishers_info_by_topic(NODE + name)
        assert offer.qos_profile.reliability.name == 'RELIABLE'
        latched = offer.qos_profile.durability.name == 'TRANSIENT_LOCAL'
        assert latched == (name in LATCHED), name
    diagnostics = layout['configById']['DiagnosticSummary!node']['topicToRender']
    for topic in (NODE + 'graph_stats', diagnostics):
        assert published[topic] == ['diagnostic_msgs/msg/DiagnosticArray']


def test_foxglove_shows_the_same_topics(layout):
    panel = layout['configById']['3D!map']
    assert panel['topics'].keys() == {NODE + name for name in DISPLAYS}
    assert panel['followTf'] == 'map'


def test_foxglove_panels_are_placed_once(layout):
    def leaves(node):
        if isinstance(node, str):
            return [node]
        return leaves(node['first']) + leaves(node['second'])

    placed = leaves(layout['layout'])
    assert sorted(placed) == sorted(layout['configById'])
    kinds = {name.split('!')[0] for name in placed}
    assert kinds == {'3D', 'Plot', 'DiagnosticSummary'}


def test_foxglove_plots_keys_that_exist(layout, map_light, light_bag):
    done = map_light(light_bag)
    known = done.stats.keys() | {f'window.{name}' for name in done.rows[0]}
    paths = [
        path['value']
        for name, panel in layout['configById'].items()
        if name.startswith('Plot!')
        for path in panel['paths']
    ]
    assert len(paths) >= 6
    for path in paths:
        topic, key = re.fullmatch(
            r'(\S+?)\.status\[:\]\.values\[:\]\{key=="([\w.]+)"\}\.value', path
        ).groups()
        assert topic == NODE + 'graph_stats'
        assert key in known
