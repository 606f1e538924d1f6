"""Two nodes of one name are told of each other."""

import time
from contextlib import contextmanager

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from ros_helpers import next_domain

from incremental_mapper.ros import namesakes
from incremental_mapper.ros.namesakes import Namesakes


@contextmanager
def mapper(domain, namespace=''):
    """A node that publishes as one that maps does."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain)
    node = Node('mapper', context=context, namespace=namespace)
    node.create_publisher(Odometry, '~/odometry', 1)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def test_a_second_node_of_the_same_name_is_told_of_while_it_lasts(monkeypatch):
    monkeypatch.setattr(namesakes, 'LASTS', 0.05)
    domain = next_domain()
    with mapper(domain) as node:
        watch, told = Namesakes(node), ()
        with mapper(domain, namespace='other'), mapper(domain):
            end = time.monotonic() + 10.0
            while not told and time.monotonic() < end:
                time.sleep(0.02)
                told = watch.findings()
            (finding,) = told
            assert finding.rule == 'second_mapper' and '/mapper/odometry' in finding.text
        end = time.monotonic() + 10.0
        while told and time.monotonic() < end:
            time.sleep(0.02)
            told = watch.findings()
        assert told == ()


def test_a_node_in_a_namespace_of_its_own_is_none(monkeypatch):
    monkeypatch.setattr(namesakes, 'LASTS', 0.01)
    domain = next_domain()
    with mapper(domain) as node, mapper(domain, namespace='other'):
        watch = Namesakes(node)
        deadline = time.monotonic() + 4.0
        while node.count_publishers('/other/mapper/odometry') == 0:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        assert watch.findings() == ()
