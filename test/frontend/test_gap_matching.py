"""Scans that are seconds apart: matched where that is certain, never by chance."""

import gtsam
import numpy as np
import pytest
from driven_room import STEP, assert_close, front_end, room, scan, seen_from, stamp

from incremental_mapper.config import OdometryMethod


def at(seconds, pace):
    """T_room_base of a vehicle that goes on by STEP ``pace`` times a second."""
    return gtsam.Pose3.Expmap(gtsam.Pose3.Logmap(STEP) * (seconds * pace))


FINE = {'voxel_size': 0.5}
"""Points must be nearer to each other than what a match explains."""


def dense(seed):
    return room(12_000, seed)


def keyframes(end, times, pace, scene=dense):
    prepared = []
    for i, seconds in enumerate(times):
        cloud = seen_from(at(seconds, pace), scene(seed=i))
        prepared += end.prepare((scan(seconds, cloud),))
    return prepared


@pytest.mark.parametrize('period', [2.0, 5.0])
@pytest.mark.parametrize('way', [0.0, 0.8])
def test_keyframes_with_much_in_common_are_matched(period, way):
    pace = way / 0.4 / period
    times = [i * period for i in range(3)]
    end = front_end(**FINE)
    found = keyframes(end, times, pace)
    assert [item.previous for item in found] == [None, *map(stamp, times[:-1])]
    motion = at(period, pace)
    for item in found[1:]:
        assert_close(item.T_previous_current, motion, 0.05, 0.005)
    assert not end.notes


def street(seed):
    """A level road between two walls: nothing tells how far along it one is."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(-60, 60, 3000), rng.uniform(-6, 6, 3000)])
    road = np.column_stack([road, rng.normal(-1.7, 0.01, 3000)])
    walls = np.column_stack(
        [
            rng.uniform(-60, 60, 3000),
            np.repeat([-6.0, 6.0], 1500) + rng.normal(size=3000) * 0.01,
            rng.uniform(-1.7, 3, 3000),
        ]
    )
    return np.vstack([road, walls])


def rings(seed):
    """What a LiDAR sees of a bare plane, wherever it is: rings that travel with it."""
    rng = np.random.default_rng(seed)
    radii = np.repeat(np.array([4.0, 5.0, 6.5, 8.5, 11.0, 15.0, 21.0]), 400)
    angles = rng.uniform(-np.pi, np.pi, len(radii))
    flat = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    return np.column_stack([flat, rng.normal(-1.7, 0.01, len(radii))])


def elsewhere(seed):
    """Another place for every scan."""
    return np.random.default_rng(seed).uniform([-30, -30, -2], [30, 30, 6], size=(4000, 3))


@pytest.mark.parametrize('scene', [street, rings, elsewhere])
@pytest.mark.parametrize('period', [2.0, 10.0])
def test_keyframes_that_could_be_matched_anyhow_are_not(scene, period):
    end = front_end()
    found = []
    for i in range(4):
        found += end.prepare((scan(i * period, scene(seed=i)),))
    assert [item.previous for item in found] == [None] * 4
    assert end.notes == {'left: no certain match over a gap': 3}


def test_kiss_icp_does_not_match_over_gaps():
    end = front_end(method=OdometryMethod.KISS_ICP)
    found = keyframes(end, [0.0, 2.0, 4.0], 0.0)
    assert [item.previous for item in found] == [None] * 3


def test_chain_goes_on_over_a_gap_of_a_steady_drive():
    end = front_end(**FINE)
    found = keyframes(end, [0.0, 0.1, 0.2, 0.3, 1.8, 1.9], 3.0)
    assert [item.previous for item in found][4:] == [stamp(0.3), stamp(1.8)]
    assert_close(found[4].T_previous_current, at(1.5, 3.0), 0.05, 0.005)


def test_change_of_speed_is_allowed_for_the_gap():
    end = front_end()
    prepared = []
    way = 0.0
    for seconds, step in ((0.0, 0.0), (1.0, 1.0), (2.0, 2.6), (3.0, 4.8)):
        way += step
        pose = gtsam.Pose3(gtsam.Rot3(), np.array([way, 0.0, 0.0]))
        prepared += end.prepare((scan(seconds, seen_from(pose, room(seed=int(way)))),))
    # From 2.6 m/s to 4.8 m/s is more than a scan at 10 Hz could say.
    assert prepared[-1].previous == stamp(2.0)
