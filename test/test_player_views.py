"""The RViz2 configuration and the Foxglove layout show what the node publishes."""

import json
import re
from pathlib import Path

import pytest
import yaml

CONFIG = Path(__file__).parent.parent / 'config'
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


@pytest.fixture
def rviz():
    text = (CONFIG / 'incremental_mapper.rviz').read_text()
    return yaml.safe_load(text)['Visualization Manager']


@pytest.fixture
def layout():
    return json.loads((CONFIG / 'foxglove_layout.json').read_text())


def test_rviz_displays(rviz):
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
