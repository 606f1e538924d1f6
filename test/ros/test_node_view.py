"""What Rerun shows of a node, from its messages."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')
pytest.importorskip('rerun', reason='rerun-sdk is not installed (extra "view")')

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
