"""Scans of one LiDAR made ready for the map, for scoring, and for another process."""

import pickle
from collections import Counter

import numpy as np
from driven_room import STEP, assert_close, drive, poses, room, scan, seen_from

from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.frontend.lidar_odometry import ScanPreparer
from incremental_mapper.settings import make_config


def test_coarse_map_takes_nothing_from_the_matching():
    end = FrontEnd(make_config({'map': {'voxel_size': 3.0}, 'lidars': {'left': {}}}))
    found = drive(end, [0.0, 0.1, 0.2, 0.3])
    for item in found[1:]:
        assert_close(item.T_previous_current, STEP, 0.03, 0.003)
    cells = np.floor(found[3].thinned / 3.0)
    assert len(np.unique(cells, axis=0)) == len(cells)


def test_scans_of_a_lidar_can_be_prepared_in_another_process():
    config = make_config({'lidars': {'left': {}}})
    here, there = (ScanPreparer('left', config, Counter()) for _ in range(2))
    for i, pose in enumerate(poses(3)):
        raw = scan(i / 10, seen_from(pose, room(seed=i)))
        expected = here.prepare(raw)
        found = pickle.loads(pickle.dumps(there.prepare(pickle.loads(pickle.dumps(raw)))))
        assert np.array_equal(found.thinned, expected.thinned)
        assert found.core == expected.core
        assert found.previous == expected.previous
    assert found.T_previous_current.equals(expected.T_previous_current, 1e-12)
