"""Frames that two programs tell of: messages as they come, no middleware."""

from types import SimpleNamespace

import gtsam
import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from incremental_mapper.config import FrameSettings, TfMode
from incremental_mapper.ros.shared_frames import PROOF, SharedFrames
from incremental_mapper.ros.transforms import transform_message


def tf(*edges, stamp=0):
    """A ``tf2_msgs/TFMessage`` of (parent, child)."""
    made = [transform_message(stamp, *edge, gtsam.Pose3()) for edge in edges]
    return SimpleNamespace(transforms=made)


def rounds(shared, *edges, count=10, own=()):
    for stamp in range(count):
        for child in own:
            shared.sent(child, stamp)
            shared.moving(tf(('any', child), stamp=stamp))
        shared.moving(tf(*edges, stamp=stamp))


@pytest.mark.parametrize(
    ('publish', 'edges', 'shared_with'),
    [
        (TfMode.BOTH, [('odom', 'base_link')], ['odom']),
        (TfMode.BOTH, [('odom', 'base_footprint'), ('base_footprint', 'base_link')], ['base_foot']),
        (TfMode.BOTH, [('map', 'odom')], ['map']),
        (TfMode.BOTH, [('base_link', 'wheel'), ('world', 'map')], []),
        (TfMode.MAP_TO_ODOM, [('odom', 'base_link')], []),
        (TfMode.MAP_TO_ODOM, [('map', 'odom')], ['map']),
        (TfMode.NONE, [('map', 'odom'), ('odom', 'base_link')], []),
    ],
)
def test_a_frame_that_another_program_places_is_said(publish, edges, shared_with):
    shared = SharedFrames(publish, FrameSettings())
    rounds(shared, *edges)
    found = shared.findings()
    assert [finding.rule for finding in found] == ['shared_frame'] * len(shared_with)
    for finding, parent in zip(found, shared_with, strict=True):
        assert parent in finding.text and ('map_to_odom' in finding.remedy) is (
            publish is TfMode.BOTH
        )


def test_what_this_node_sends_comes_back_to_it_and_is_no_other():
    shared = SharedFrames(TfMode.BOTH, FrameSettings())
    rounds(shared, ('base_link', 'wheel'), own=['odom', 'base_link'])
    assert shared.findings() == ()
    shared.moving(tf(('odom', 'base_link'), stamp=99))
    assert shared.findings() == ()  # one may be a stray one


def test_a_second_mapper_with_the_same_stamps_is_another_program():
    shared = SharedFrames(TfMode.BOTH, FrameSettings())
    for stamp in range(PROOF):
        shared.sent('odom', stamp)
        for _ in range(2):
            shared.moving(tf(('map', 'odom'), stamp=stamp))
    assert len(shared.findings()) == 1


def test_a_static_parent_of_the_base_is_said_at_once():
    shared = SharedFrames(TfMode.BOTH, FrameSettings())
    shared.static(tf(('base_footprint', '/base_link'), ('base_link', 'velodyne')))
    (finding,) = shared.findings()
    assert '/tf_static' in finding.text
