"""The node as a program of its own: what keeps it from starting."""

import signal
import subprocess
import sys

import pytest
import yaml

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from ros_helpers import next_domain

from incremental_mapper import __version__
from incremental_mapper.cli import mapper_node
from incremental_mapper.ros.programs import local_environment, node_command


def launch(tmp_path, tree, *arguments):
    path = tmp_path / 'parameters.yaml'
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
    return subprocess.Popen(
        [*node_command([path]), *arguments],
        env=local_environment(next_domain()),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )


@pytest.mark.parametrize(
    ('tree', 'word'),
    [({'window': {'duratoin': 0.2}}, 'duratoin'), ({'map': {'voxel_size': -1.0}}, 'voxel_size')],
)
def test_wrong_parameter_stops_the_node_with_one_line(tmp_path, tree, word):
    process = launch(tmp_path, tree)
    out, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert len(err.splitlines()) == 1 and word in err
    assert err.startswith('incremental_mapper: ') and out == ''


@pytest.mark.parametrize(
    ('word', 'said'),
    [
        ('qos_overrides./imu.subscription.depth:=many', "depth is 'many'"),
        ('use_sim_time:=5', 'use_sim_time is 5; it must be true or false'),
        ('lidars.names:=[]', 'empty list'),
        ('graph.lag:=five', "graph.lag is 'five'"),
        ('tf.publish:=true', 'tf.publish is True'),
        ('imu.topic:=5', 'imu.topic is 5'),
    ],
)
def test_a_value_of_the_wrong_type_is_named_and_stops_the_node(tmp_path, word, said):
    process = launch(tmp_path, {}, '-p', word)
    _, err = process.communicate(timeout=60.0)
    assert process.returncode == 1
    line = err.splitlines()[-1]
    assert line.startswith('incremental_mapper: ') and said in line and 'Traceback' not in err


def test_damaged_parameter_file_stops_the_node_with_one_line(tmp_path):
    process = launch(tmp_path, {}, '--params-file', str(tmp_path / 'missing.yaml'))
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert 'missing.yaml' in err and 'Traceback' not in err


@pytest.mark.parametrize(
    'module', ['incremental_mapper.cli.mapper_node', 'incremental_mapper.ros.node']
)
@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['--help'], 'usage: mapper_node'),
        (['--version'], f'mapper_node {__version__}\n'),
        (['--ros-args', '-p', 'graph.lag:=1.0', '--', '-h'], '--params-file'),
    ],
)
def test_help_and_version_start_no_node(module, words, said):
    command = [sys.executable, '-m', module, *words]
    environment = local_environment(next_domain())
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stderr == ''
    assert said in done.stdout


def test_without_ros_the_program_says_so(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.split('.')[0] == 'rclpy']:
        monkeypatch.delitem(sys.modules, name)
    for name in [name for name in sys.modules if name.startswith('incremental_mapper.ros')]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, 'rclpy', None)
    before = signal.getsignal(signal.SIGINT)
    assert mapper_node.main(['mapper_node']) == 1
    assert signal.getsignal(signal.SIGINT) is before
    err = capsys.readouterr().err
    assert 'pip install "incremental_mapper[ros]"' in err and err.count('\n') == 1


@pytest.mark.parametrize(
    ('module', 'loaded'),
    [
        ('incremental_mapper.cli.mapper_node', 'incremental_mapper.ros.node'),
        ('incremental_mapper.ros.node', 'rclpy'),
        ('incremental_mapper.ros.node', 'incremental_mapper.ros.publishers'),
    ],
)
def test_a_signal_while_the_node_is_loaded_ends_it_without_a_traceback(module, loaded):
    code = f"""
import os, runpy, signal, sys

class Interrupted:
    def find_spec(self, name, *_):
        if name == '{loaded}':
            os.kill(os.getpid(), signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Interrupted())
sys.argv = ['mapper_node']
runpy.run_module('{module}', run_name='__main__')
"""
    ended = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == -signal.SIGINT and ended.stderr == ''
