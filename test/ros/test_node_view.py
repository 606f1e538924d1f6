"""What Rerun shows of a node, from its messages."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')
pytest.importorskip('rerun', reason='rerun-sdk is not installed (extra "view")')

from incremental_mapper.mapping.live_map import PathView
from incremental_mapper.results.messages.graph_markers import no_markers
from incremental_mapper.results.messages.message_types import BagTypes
from incremental_mapper.results.messages.result_messages import ResultMessages
from incremental_mapper.ros.client import Heard
from incremental_mapper.ros.node_view import NodeView
from incremental_mapper.visualization.rerun_scene import RerunScene


def test_window_without_new_points_does_not_end_the_view(tmp_path):
    seen = []
    scene = RerunScene(tmp_path / 'node.rrd')
    scene.points = lambda points, height: seen.append(points)
    view = NodeView(scene)
    messages = ResultMessages(BagTypes())
    some = np.arange(8.0).reshape(2, 4)
    for points in (np.zeros((0, 3)), np.zeros((0, 4)), some):
        view.points(Heard(messages.cloud(7, points, 'map'), 0, 0))
    scene.close()
    assert [len(points) for points in seen] == [0, 0, 2]
    assert np.array_equal(seen[-1], some[:, :3])


def test_map_that_begins_anew_leaves_nothing_of_the_old_one(tmp_path):
    messages, path = ResultMessages(BagTypes()), tmp_path / 'node.rrd'
    scene = RerunScene(path, candidates=False)
    view = NodeView(scene)

    def cloud(stamp, place):
        view.points(Heard(messages.cloud(stamp, np.full((1, 3), place), 'map'), 0, 0))

    def way(stamp, place):
        pose = [place, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
        view.path(Heard(messages.path(stamp, PathView([stamp], [pose]), 'map'), 0, 0))

    nothing = messages.path(0, PathView([], []), 'map')
    view.path(Heard(nothing, 0, 0))  # before the first map there is none to be left
    cloud(7 * 10**9, 123.25)
    way(7 * 10**9, 124.25)
    view.path(Heard(nothing, 0, 0))
    view.graph(Heard(no_markers(messages, 'map'), 0, 0))
    cloud(5 * 10**9, 456.25)
    way(5 * 10**9, 457.25)
    scene.close()
    first, second = (printed(file) for file in (path, tmp_path / 'node_2.rrd'))
    assert '123.25' in first and '124.25' in first
    assert '456.25' not in first and '457.25' not in first
    assert '456.25' in second and '457.25' in second
    assert '123.25' not in second and '124.25' not in second
    assert '1970-01-01T00:00:00' not in first + second  # what takes away has no stamp
    assert sorted(file.name for file in tmp_path.iterdir()) == ['node.rrd', 'node_2.rrd']


def printed(path):
    """A recording as Rerun's own program prints it."""
    command = [sys.executable, '-m', 'rerun_cli', 'rrd', 'print', '-vvv', str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout
