"""The node as a program of its own: start, signals, exit status."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import yaml

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from ros_helpers import INPUTS, Spinner, bag_parameters, next_domain, read_inputs

from incremental_mapper.trajectory import NANOSECONDS, read_tum

COMMAND = [sys.executable, '-m', 'incremental_mapper.ros.node', '--ros-args']


def launch(tmp_path, domain, tree, *arguments):
    path = tmp_path / 'parameters.yaml'
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': tree}}))
    return subprocess.Popen(
        [*COMMAND, '--params-file', str(path), *arguments],
        env={**os.environ, 'ROS_DOMAIN_ID': str(domain)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )


@pytest.fixture
def client():
    """A ROS node in a domain of its own: (domain, node)."""
    context, domain = Context(), next_domain()
    rclpy.init(context=context, domain_id=domain)
    node = Node('client', context=context)
    spinner = Spinner(context, node)
    yield domain, node
    spinner.close()
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGINT])
def test_signal_in_the_middle_saves_a_complete_map(tmp_path, light_bag, client, number):
    domain, node = client
    saved = tmp_path / 'maps' / 'last'
    tree = bag_parameters(light_bag, {'save': {'on_shutdown': str(saved)}})
    process = launch(tmp_path, domain, tree)
    heard = []
    enough = threading.Event()

    def on_odometry(message):
        heard.append(message)
        if len(heard) >= 8:
            enough.set()

    node.create_subscription(Odometry, '/incremental_mapper/odometry', on_odometry, 100)
    publishers = {
        topic: node.create_publisher(kind, topic, QoSProfile(depth=1000))
        for topic, kind in INPUTS.items()
    }
    try:
        end = time.monotonic() + 15.0
        while not all(item.get_subscription_count() for item in publishers.values()):
            assert time.monotonic() < end and process.poll() is None
            time.sleep(0.05)
        time.sleep(0.3)
        messages = read_inputs(light_bag)
        begin = time.monotonic()
        for item in messages:
            due = begin + (item.logged - messages[0].logged) / NANOSECONDS
            time.sleep(max(due - time.monotonic(), 0.0))
            publishers[item.topic].publish(item.content)
            if enough.is_set():
                break
        assert enough.wait(10.0)
        process.send_signal(number)
        out, err = process.communicate(timeout=20.0)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert 'Traceback' not in out + err
    stats = json.loads((saved / 'stats.json').read_text())
    assert stats['clusters'] == len(read_tum(saved / 'trajectory.tum')) >= 8
    assert stats['unused_measurements'] == 0
    graph = json.loads((saved / 'graph.json').read_text())
    assert len(graph['factors']) == stats['factors']
    assert (saved / 'map.ply').read_bytes().startswith(b'ply\n')
    assert [path.name for path in saved.parent.iterdir()] == ['last']


@pytest.mark.parametrize(
    ('tree', 'word'),
    [({'window': {'duratoin': 0.2}}, 'duratoin'), ({'map': {'voxel_size': -1.0}}, 'voxel_size')],
)
def test_wrong_parameter_stops_the_node_with_one_line(tmp_path, tree, word):
    process = launch(tmp_path, next_domain(), tree)
    out, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert len(err.splitlines()) == 1 and word in err
    assert err.startswith('incremental_mapper: ') and out == ''


def test_damaged_parameter_file_stops_the_node_with_one_line(tmp_path):
    process = launch(tmp_path, next_domain(), {}, '--params-file', str(tmp_path / 'missing.yaml'))
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert 'missing.yaml' in err and 'Traceback' not in err
