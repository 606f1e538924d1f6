"""Services, time jumps and parameters of the node."""

import json

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from collections import Counter
from dataclasses import replace
from itertools import count

import rclpy
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from ros_helpers import (
    NodeSession,
    assert_same_graph,
    bag_parameters,
    decode_cloud,
    map_offline,
    next_domain,
)

import incremental_mapper.mapping.incremental_graph as graph_module
from incremental_mapper.errors import ConfigError
from incremental_mapper.mapping.commit import commit
from incremental_mapper.ros import saving as saving_module
from incremental_mapper.ros.node import MapperNode
from incremental_mapper.selection import strategies


def vertices(folder):
    return json.loads((folder / 'stats.json').read_text())['vertices']


def part(messages, seconds):
    return [item for item in messages if item.logged < messages[0].logged + seconds * 1e9]


def message_of(session, part):
    """What the newest diagnostics say of a part of the node."""
    parts = session.received['diagnostics'][-1].status
    return next(item.message for item in parts if item.name.endswith(f': {part}'))


def test_save_reset_pause(start_node, messages, tmp_path):
    session = start_node()
    success, message = session.call('save_map')
    assert not success and 'empty' in message
    assert not (tmp_path / 'saved').exists()
    session.play(part(messages, 1.2))
    session.finish()
    for number in ('', '_2'):
        success, message = session.call('save_map')
        assert success and message == f'saved to {tmp_path}/saved{number}'
    assert vertices(tmp_path / 'saved') == vertices(tmp_path / 'saved_2') > 10
    assert not [path for path in tmp_path.iterdir() if path.name.startswith('.saved')]
    session.wait(lambda: len(decode_cloud(session.received['map'][-1])), 'a map')
    assert session.call('reset')[0]
    session.wait(lambda: not len(decode_cloud(session.received['map'][-1])), 'the map is empty')
    session.wait(lambda: not session.received['path'][-1].poses, 'the path is empty')
    assert len(session.received['graph'][-1].markers) == 1
    assert not session.call('save_map')[0]
    assert session.call('pause', True)[0]
    windows = len(session.received['graph_stats'])
    session.play(part(messages, 0.5), rate=5.0)
    session.finish()
    assert session.dropped('imu') == {'paused': sum(m.topic == '/imu' for m in part(messages, 0.5))}
    assert len(session.received['graph_stats']) == windows
    assert session.call('pause', False)[0]
    session.play(part(messages, 0.8))
    assert session.finish()['clusters'] > 0


def looped(messages):
    shift = messages[-1].logged - messages[0].logged + 100_000_000
    return [
        *messages,
        *(replace(item, logged=item.logged + shift) for item in messages),
    ]


def test_looped_bag_starts_a_new_map_after_saving_the_old(
    start_node, messages, light_bag, tmp_path
):
    session = start_node({'save': {'on_shutdown': str(tmp_path / 'last')}})
    session.play(looped(messages))
    session.finish()
    assert session.diagnostics()['worker']['time_jumps'] == 1
    assert session.call('save_map')[0]
    offline = map_offline(light_bag, bag_parameters(light_bag))
    assert_same_graph(tmp_path / 'last', offline)
    assert_same_graph(tmp_path / 'saved', offline)
    session.stop()
    assert_same_graph(tmp_path / 'last_2', offline)


def test_looped_bag_is_ignored_where_the_policy_says_so(start_node, messages, light_bag, tmp_path):
    session = start_node({'time_jump': {'policy': 'ignore'}})
    session.play(looped(part(messages, 1.6)))
    session.finish()
    # All that goes back is left out: by the filter, or by the windows that are closed.
    dropped = session.dropped('imu')
    assert dropped['time_jump'] > 10
    went_back = ('time_jump', 'late', 'duplicate_stamp')
    assert sum(dropped.get(reason, 0) for reason in went_back) > 140
    first = session.call('save_map')
    assert first[0]
    assert session.stats()[-1]['received']['left'] < 2 * 16


@pytest.mark.parametrize(
    ('tree', 'words'),
    [
        ({'windw': {'duration': 0.1}}, ('windw', 'window')),
        ({'window': {'duraton': 0.1}}, ('window.duraton', 'duration')),
        ({'window': {'duration': 50.0}}, ('window.duration', '50.0', '5')),
        ({'window': {'duration': 'long'}}, ('window.duration', 'long')),
        ({'time_jump': {'policy': 'panic'}}, ('time_jump.policy', 'reset', 'ignore')),
        ({'lidars': {'names': ['left'], 'rigth': {'topic': '/a'}}}, ('rigth',)),
        ({'lidars': {'names': ['imu']}}, ('imu',)),
        ({'imu': {'T_base_sensor': [1.0, 2.0]}}, ('imu.T_base_sensor', '7', '12')),
    ],
)
def test_wrong_parameters_are_refused(tmp_path, tree, words):
    with pytest.raises(ConfigError) as caught:
        NodeSession(tmp_path, tree)
    assert '\n' not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_a_node_that_has_ended_is_nowhere_any_more(start_node):
    """rclpy ends a node when nothing holds it, and its log with that of a later namesake."""
    session = start_node()
    name = session.mapper.node.get_name()
    session.wait(lambda: name in session.client.get_node_names(), 'the node')
    session.stop()
    session.wait(lambda: name not in session.client.get_node_names(), 'the end of the node')


def test_a_node_whose_qos_is_refused_is_nowhere_any_more():
    context = Context()
    rclpy.init(
        context=context, domain_id=next_domain(), signal_handler_options=SignalHandlerOptions.NO
    )
    try:
        with pytest.raises(ConfigError, match=r'/imu\.subscription\.reliability is 5'):
            MapperNode(
                context=context,
                cli_args=['--ros-args', '-p', 'qos_overrides./imu.subscription.reliability:=5'],
            )
        observer = Node('observer', context=context)
        assert observer.get_node_names() == ['observer']
        observer.destroy_node()
    finally:
        rclpy.try_shutdown(context=context)


def test_parameters_have_descriptions_and_only_safe_ones_change(start_node):
    session = start_node({'window': {'duration': 1}, 'imu': {'time_offset': 0.25}})
    node = session.mapper.node
    assert node.get_parameter('imu.time_offset').value == 0.25
    assert node.get_parameter('window.duration').value == 1.0
    assert node.get_parameter('lidars.names').value == ['left', 'right']
    assert len(node.get_parameter('lidars.left.T_base_sensor').value) == 12

    def ask(kind, name, request):
        client = session.client.create_client(kind, f'/incremental_mapper/{name}')
        assert client.wait_for_service(5.0)
        future = client.call_async(request)
        session.wait(future.done, name)
        return future.result()

    names = ['window.duration', 'map.publish_period', 'selection.max_candidates']
    found = ask(
        DescribeParameters, 'describe_parameters', DescribeParameters.Request(names=names)
    ).descriptors
    assert [item.read_only for item in found] == [True, False, True]
    assert all(item.description for item in found)
    assert found[0].floating_point_range[0].to_value == 5.0
    assert found[2].integer_range[0].from_value == 1

    def change(name, value):
        wanted = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[wanted])
        return ask(SetParameters, 'set_parameters', request).results[0]

    assert change('map.publish_period', 0.5).successful
    assert session.mapper.parameters.config.map.publish_period == 0.5
    assert not change('map.publish_period', -1.0).successful
    assert not change('window.duration', 0.2).successful


class Explosive:
    """Chooses as ``min_time_shift`` does, and raises in its tenth window."""

    def __init__(self):
        self._windows = count(1)

    def warm_up(self):
        pass

    def select(self, problem):
        if next(self._windows) == 10:
            raise ValueError('the strategy explodes')
        return strategies.find_strategy('min_time_shift').select(problem)


def test_choice_that_raises_costs_its_window_alone(start_node, messages, monkeypatch):
    monkeypatch.setitem(strategies.BUILT_IN, 'explosive', Explosive())
    session = start_node({'selection': {'strategy': 'explosive'}})
    session.play(messages)
    stats = session.finish()
    assert stats['failed_windows'] == 1
    assert stats['windows'] > 18 and stats['components'] == 1
    found = session.diagnostics()
    assert found['worker']['mapper_failures'] == 0
    assert found['map']['failed_windows'] == 1
    lost = Counter({name: found[name]['dropped']['window_failed'] for name in ('left', 'right')})
    assert 0 < lost.total() <= 3
    assert message_of(session, 'map') == 'windows failed: 1'


@pytest.fixture
def explosive(monkeypatch):
    """A mapper that raises once the choice of its tenth window is made."""
    windows = count(1)

    def explode(*arguments):
        if next(windows) == 10:
            raise ValueError('the mapper explodes')
        return commit(*arguments)

    monkeypatch.setattr(graph_module, 'commit', explode)


@pytest.mark.parametrize('saves', [True, False])
def test_exception_in_the_mapper_loses_no_map(start_node, messages, tmp_path, explosive, saves):
    saving = {'save': {'on_shutdown': str(tmp_path / 'kept') if saves else ''}}
    session = start_node({'selection': {'strategy': 'min_time_shift'}}, saving)
    session.play(messages)
    stats = session.finish()
    found = session.diagnostics()
    assert found['worker']['mapper_failures'] == 1
    assert 'mapper failures: 1' in message_of(session, 'worker')
    # Nine windows, nine more after the one that failed, and every scan and fix accounted for.
    assert stats['windows'] > 9 and stats['components'] == 1
    assert (tmp_path / 'kept').exists() == saves
    assert session.call('save_map')[0]
    used = members(tmp_path / 'saved')
    lost = Counter({name: found[name]['dropped']['mapper_failed'] for name in ('left', 'right')})
    assert 0 < lost.total() < 30
    if saves:
        used += members(tmp_path / 'kept')
        assert json.loads((tmp_path / 'kept' / 'stats.json').read_text())['windows'] == 9
        for name in ('left', 'right'):
            assert used[name] + lost[name] == sum(m.topic == f'/points_{name}' for m in messages)


def test_failed_save_keeps_the_map(start_node, messages, tmp_path, monkeypatch):
    session = start_node()
    session.play(part(messages, 0.8))
    session.finish()
    monkeypatch.setattr(saving_module, 'write_result', lambda *_: 1 / 0)
    assert session.call('save_map') == (False, 'saving failed; the log says how')
    assert not [path for path in tmp_path.iterdir() if 'saved' in path.name]
    monkeypatch.undo()
    assert session.call('save_map')[0]
    assert vertices(tmp_path / 'saved') > 0
    assert session.diagnostics()['worker']['mapper_failures'] == 0


def members(folder):
    """Measurements of a saved map by sensor."""
    graph = json.loads((folder / 'graph.json').read_text())
    return Counter(member['sensor'] for item in graph['clusters'] for member in item['members'])


def test_folder_of_a_save_may_change_while_the_node_runs(start_node, messages, tmp_path, capfd):
    session = start_node()
    session.play(part(messages, 0.8))
    session.finish()
    parameters = session.mapper.node
    for wrong in ('', '/', '..'):
        (answer,) = parameters.set_parameters([Parameter('save.folder', value=wrong)])
        assert not answer.successful and 'save.folder' in answer.reason
    (tmp_path / 'file').touch()
    (answer,) = parameters.set_parameters([Parameter('save.folder', value=f'{tmp_path}/file/h')])
    assert answer.successful  # a disk may come yet
    assert f'save.folder: {tmp_path}/file/h could not be made now' in capfd.readouterr().err
    (answer,) = parameters.set_parameters([Parameter('save.folder', value=f'{tmp_path}/hall')])
    assert answer.successful and 'could not be made' not in capfd.readouterr().err
    assert session.call('save_map') == (True, f'saved to {tmp_path}/hall')
    assert vertices(tmp_path / 'hall') > 0
