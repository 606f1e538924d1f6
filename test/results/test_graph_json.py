"""Two saved graphs side by side."""

import copy
import json

import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import compare_graphs


@pytest.fixture(scope='module')
def graph():
    """Two poses and a velocity, as graph.json has them."""
    member = {'sensor': 'left', 'kind': 'lidar', 'stamp_ns': 5}
    clusters = [
        {'id': 0, 'window': 0, 'stamp_ns': 5, 'first_ns': 5, 'last_ns': 5, 'members': [member]},
        {'id': 1, 'window': 1, 'stamp_ns': 9, 'first_ns': 9, 'last_ns': 9, 'members': [member]},
    ]
    variables = [
        {'key': 'x0', 'kind': 'pose', 'value': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]},
        {'key': 'v0', 'kind': 'velocity', 'value': [1.0, 0.0, 0.0]},
        {'key': 'x1', 'kind': 'pose', 'value': [1.0, 0.0, 0.0, 0.0, 0.0, 0.6, 0.8]},
    ]
    factors = [
        {'kind': 'prior_pose', 'variables': ['x0'], 'sensor': None, 'stamps_ns': [5]},
        {'kind': 'odometry', 'variables': ['x0', 'x1'], 'sensor': 'left', 'stamps_ns': [5, 9]},
    ]
    return {'clusters': clusters, 'variables': variables, 'factors': factors}


def changed(graph, change):
    other = copy.deepcopy(graph)
    change(other)
    return compare_graphs(graph, other)


def test_same_graph(graph):
    found = compare_graphs(graph, json.loads(json.dumps(graph)))
    assert (found.clusters, found.variables, found.factors) == (2, 3, 2)
    assert found.worst == 0.0 and found.differences == ()


def test_small_differences_of_numbers_are_no_difference(graph):
    def move(other):
        other['variables'][2]['value'][0] += 9e-7

    found = changed(graph, move)
    assert found.differences == () and found.worst == pytest.approx(9e-7)


def test_negative_quaternion_is_the_same_turn(graph):
    def negate(other):
        value = other['variables'][2]['value']
        value[3:] = [-number for number in value[3:]]

    assert changed(graph, negate).worst == 0.0


def without_the_last(name):
    return lambda other: other[name].pop()


def put(place, value):
    def change(other):
        *path, last = place
        branch = other
        for step in path:
            branch = branch[step]
        branch[last] = value

    return change


@pytest.mark.parametrize(
    ('change', 'words'),
    [
        (without_the_last('clusters'), '2 and 1 clusters'),
        (without_the_last('factors'), '2 and 1 factors'),
        (without_the_last('variables'), '1 variables are in one graph only, such as x1'),
        (put(('clusters', 1, 'stamp_ns'), 8), 'clusters differ from number 1 on'),
        (put(('clusters', 0, 'members', 0, 'sensor'), 'right'), 'clusters differ from number 0'),
        (put(('factors', 1, 'variables'), ['x1', 'x0']), 'factors differ from number 1 on'),
        (put(('factors', 1, 'stamps_ns', 0), 4), 'factors differ from number 1 on'),
        (put(('variables', 1, 'value', 2), 2e-6), 'variable v0 differs by 2e-06'),
        (put(('variables', 2, 'value', 6), -0.8), 'variable x1 differs by 1.'),
        (put(('variables', 1, 'value', 0), float('nan')), 'variable v0 differs by inf'),
        (put(('variables', 1, 'value'), [1.0, 0.0]), 'variable v0 differs by inf'),
    ],
)
def test_differences_are_told(graph, change, words):
    found = changed(graph, change)
    assert any(words in text for text in found.differences), found.differences


@pytest.mark.parametrize('text', [None, '{"clusters": [', '{"clusters": []}', '[]'])
def test_what_is_no_graph_is_refused(tmp_path, text):
    if text is not None:
        (tmp_path / 'graph.json').write_text(text)
    with pytest.raises(InputError, match=r'graph\.json'):
        FinishedRun(tmp_path).graph  # noqa: B018 (reads the file)


def test_graph_of_a_run_is_read(map_light, light_drive):
    done = map_light(light_drive)
    assert FinishedRun(done.folder).graph == done.graph
