"""The sliding map that scans are matched to: what is in it, and when it is built anew."""

import itertools

import gtsam
import numpy as np
import pytest
from driven_room import poses, room, seen_from

from incremental_mapper.config import OdometrySettings
from incremental_mapper.frontend.local_map import RENEWAL, LocalMap, near, scan_cloud

SETTINGS = OdometrySettings(local_map_scans=4)


def scan(pose=None, seed=0):
    return scan_cloud(seen_from(pose or gtsam.Pose3(), room(seed=seed)), SETTINGS)


def driven(steps, settings=SETTINGS):
    """The maps after each of the steps, from the first scan on."""
    maps = [LocalMap.of_scan(scan())]
    pose = gtsam.Pose3()
    for i, step in enumerate(steps, 1):
        pose = pose.compose(step)
        maps.append(maps[-1].with_scan(scan(pose, i), step, settings))
    return maps


def built(maps):
    """Places at which the target is another one."""
    return [i for i in range(1, len(maps)) if maps[i].target is not maps[i - 1].target]


def ahead(metres, turn=0.0):
    return gtsam.Pose3(gtsam.Rot3.Yaw(turn), np.array([metres, 0.0, 0.0]))


def test_a_map_is_built_with_each_scan_until_it_is_whole_and_serves_several_then():
    maps = driven([ahead(0.1)] * 15)
    assert built(maps) == [1, 2, 3, 3 + RENEWAL, 3 + 2 * RENEWAL]
    assert [len(one.scans) for one in maps[:6]] == [1, 2, 3, 4, 4, 4]


@pytest.mark.parametrize('step', [ahead(1.5), ahead(0.0, 0.15)], ids=['far', 'turned'])
def test_whoever_leaves_it_gets_a_new_map_sooner(step):
    assert built(driven([step] * 9)) == [1, 2, 3, 6, 9]


def test_the_newest_scan_lies_where_the_steps_led_whenever_the_map_was_built():
    step = ahead(0.4, 0.02)
    maps = driven([step] * 10)
    for i, one in enumerate(maps):
        since = max([0, *(place for place in built(maps) if place <= i)])
        expected = gtsam.Pose3()
        for _ in range(i - since):
            expected = expected.compose(step)
        assert one.T_map_newest.equals(expected, 1e-9)


def test_its_points_are_those_of_the_last_scans_on_each_other():
    way = poses(6)
    maps = driven([one.between(other) for one, other in itertools.pairwise(way)])
    last = maps[-1]
    walls = seen_from(last.T_map_newest.inverse(), last.newest.points)
    for points in last.scans:
        apart = np.linalg.norm(points[:, None] - walls[None], axis=2).min(axis=1)
        assert np.median(apart) < 0.5


def test_a_map_of_one_scan_is_that_scan():
    maps = driven([ahead(0.1)] * 3, OdometrySettings(local_map_scans=1))
    assert all(one.target is one.newest for one in maps)


def test_all_points_are_near_where_too_few_are():
    points = room(seed=1)
    far = points + [500.0, 0.0, 0.0]
    assert near(far, SETTINGS) is far
    assert len(near(np.vstack([points, far]), SETTINGS)) == len(points)
