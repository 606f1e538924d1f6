"""The file that ``check --write`` makes is the node's parameter file as it is."""

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from ros_helpers import next_domain

from incremental_mapper.cli.main import main
from incremental_mapper.ros.node import MapperNode
from incremental_mapper.settings import load_config


def test_the_node_starts_with_the_written_file(light_bag, tmp_path):
    path = tmp_path / 'mine.yaml'
    assert main(['check', str(light_bag), '--write', str(path)]) == 0
    context = Context()
    rclpy.init(
        context=context, domain_id=next_domain(), signal_handler_options=SignalHandlerOptions.NO
    )
    try:
        node = MapperNode(context=context, cli_args=['--ros-args', '--params-file', str(path)])
        assert node.parameters.config == load_config(path)
        listened = {topic for topic, _ in node.node.get_topic_names_and_types()}
        assert {'/points_left', '/points_right', '/imu', '/fix'} <= listened
        node.spin(lambda: True)  # ends it
    finally:
        rclpy.try_shutdown(context=context)
