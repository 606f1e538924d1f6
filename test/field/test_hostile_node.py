"""Hostile messages over DDS: the node lives, keeps its map, and uses what is sound."""

import json

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed (extra "ros")')

from fuzz import NOISE, apart, write_bag
from lies.hostile import KINDS, mixed, valid
from ros_helpers import Recorded


def test_node_maps_the_drive_among_them(recording, start_node, map_light, tmp_path):
    # Base does not choose, so that what differs comes from the messages.
    bag = write_bag(valid(recording), recording, tmp_path / 'alone')
    alone = map_light(bag, strategy='base')
    session = start_node({'selection': {'strategy': 'base'}})
    session.play(
        [
            Recorded(sent.logged, sent.topic, sent.data)
            for sent in mixed(recording, 300, seed=3)
            if sent.topic in KINDS
        ],
        rate=0.5,
    )
    session.finish(lossless=False)
    session.call('save_map')
    assert session.failure is None
    worker = session.diagnostics()['worker']
    assert worker['mapper_failures'] == 0
    saved = tmp_path / 'saved'
    clusters = json.loads((saved / 'graph.json').read_text())['clusters']
    members = {(m['sensor'], m['stamp_ns']) for item in clusters for m in item['members']}
    for sensor in ('left', 'right'):
        missed = [stamp for stamp in alone.used(sensor) if (sensor, stamp) not in members]
        assert len(missed) <= 2, sensor
    rms, _, count = apart(alone.folder / 'trajectory.tum', saved / 'trajectory.tum')
    assert count > 20 and rms < NOISE
