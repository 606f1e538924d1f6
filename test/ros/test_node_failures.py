"""The node where its disk fails: services answer, diagnostics tell, and mapping goes on."""

import os
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from diagnostic_msgs.msg import DiagnosticStatus
from ros_helpers import NodeSession, bag_parameters, decode_cloud


@pytest.fixture
def session(tmp_path, light_bag):
    """A node that keeps its scans in ``tmp_path / 'store'`` and has no readers yet."""
    (tmp_path / 'store').mkdir()
    tree = {
        'map': {'store': 'disk', 'store_folder': str(tmp_path / 'store')},
        'save': {'folder': str(tmp_path / 'saved'), 'pictures': False},
    }
    made = NodeSession(tmp_path, bag_parameters(light_bag, tree), listen=False)
    yield made
    made.close()


def empty_store(folder):
    """Take away what a store has written to ``folder``, as a failing disk would."""
    found = [
        path
        for path in Path('/proc/self/fd').iterdir()
        if path.is_symlink() and str(path.readlink()).startswith(str(folder))
    ]
    # The candidates lie there too, and take less.
    os.truncate(max(found, key=lambda path: path.stat().st_size), 0)


def worker_status(session):
    """Level and message of the worker's diagnostics."""
    session.diagnostics()
    newest = session.received['diagnostics'][-1]
    (found,) = [item for item in newest.status if item.name.endswith('worker')]
    return found.level, found.message


def test_map_is_published_again_after_the_mapper_failed_over_it(session, messages, tmp_path):
    half = messages[len(messages) // 2].logged
    session.play([item for item in messages if item.logged < half])
    session.finish()
    empty_store(tmp_path / 'store')
    session.listen('/incremental_mapper/map', *session.of('map'))
    session.wait(lambda: session.diagnostics()['worker']['mapper_failures'] == 1, 'a failure')
    session.play([item for item in messages if item.logged >= half])
    session.finish()
    session.wait(lambda: len(decode_cloud(session.received['map'][-1])) > 1000, 'the new map')
    level, message = worker_status(session)
    assert level != DiagnosticStatus.OK and 'mapper failures: 1' in message


def test_services_answer_while_no_map_can_be_begun(session, messages, tmp_path):
    (tmp_path / 'store').rmdir()
    success, message = session.call('reset')
    assert not success and 'store: cannot hold the map' in message
    for name in ('flush', 'save_map'):
        success, message = session.call(name)
        assert not success and 'no map' in message
    level, message = worker_status(session)
    assert level == DiagnosticStatus.ERROR and 'no map' in message
    assert session.diagnostics()['worker']['mapper_failures'] == 1
    (tmp_path / 'store').mkdir()
    assert session.call('reset')[0]
    session.play(messages)
    session.finish()
    assert session.call('save_map')[0]
    assert (tmp_path / 'saved' / 'map.ply').stat().st_size > 10_000
