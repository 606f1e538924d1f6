"""A live sensor on another clock: told within seconds, and its map begins anew with it mended."""

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from ros_helpers import restamp, stamp_of

from incremental_mapper.measurements import NANOSECONDS

CLOUDS = ('/points_left', '/points_right')


def shifted(messages, seconds):
    """The clouds' stamps moved, the rest as it is."""

    def move(message):
        return restamp(message, stamp_of(message) + round(seconds * NANOSECONDS))

    return [item.changed(move) if item.topic in CLOUDS else item for item in messages]


@pytest.mark.parametrize('seconds', [37.0, -1.5e9])
def test_clouds_of_another_clock_are_mapped_with_the_rest(start_node, messages, seconds):
    session = start_node()
    session.play(shifted(messages, seconds), rate=0.5)
    stats = session.finish()
    checks = session.diagnostics()['checks']
    assert {'clock_offset left', 'clock_offset right'} <= checks.keys()
    assert 'mended' in checks['clock_offset left']
    assert stats['factors_by_kind']['odometry'] > 30
    assert stats['factors_by_kind']['imu'] > 20
    assert stats['factors_by_kind']['gnss'] >= 2
    assert stats['components'] == 1
    assert stats['drive_s'] < 4.0


def test_an_offset_of_a_billion_seconds_is_a_parameter(start_node, messages):
    offset = {'time_offset': 1.5e9}
    session = start_node({'lidars': {'left': offset, 'right': offset}})
    session.play(shifted(messages, -1.5e9), rate=0.5)
    stats = session.finish()
    assert not any('clock' in key for key in session.diagnostics()['checks'])
    assert stats['factors_by_kind']['odometry'] > 30
    assert stats['factors_by_kind']['imu'] > 20
