"""Matches of some seconds, held against poses."""

import gtsam
import numpy as np
import pytest

from incremental_mapper.graph.factors import Factor, FactorKind
from incremental_mapper.mapping.stretches import stretches
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.variables import pose_key

STEP = gtsam.Pose3(gtsam.Rot3.Yaw(0.02), np.array([0.5, 0.0, 0.0]))
SIGMAS = np.array([0.002] * 3 + [0.02] * 3)


def matched(place, motion):
    keys = (pose_key(place), pose_key(place + 1))
    stamps = (place * NANOSECONDS // 10, (place + 1) * NANOSECONDS // 10)
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    factor = gtsam.BetweenFactorPose3(*keys, motion, noise)
    return Factor(FactorKind.ODOMETRY, keys, factor, 'left', stamps)


def poses(count, step=STEP):
    values, pose = gtsam.Values(), gtsam.Pose3()
    for place in range(count):
        values.insert(pose_key(place), pose)
        pose = pose.compose(step)
    return values


def test_a_map_that_follows_its_matches():
    (one,) = stretches([matched(place, STEP) for place in range(60)], poses(61))
    assert one.sensor == 'left'
    assert one.stamps.tolist() == [2 * NANOSECONDS, 4 * NANOSECONDS, 6 * NANOSECONDS]
    assert one.metres == pytest.approx(0.0, abs=1e-9)


def test_what_pulls_a_little_each_time_adds_up():
    pulled = gtsam.Pose3(STEP.rotation(), np.array([0.5, 0.02, 0.0]))
    (one,) = stretches([matched(place, STEP) for place in range(20)], poses(21, pulled))
    assert one.metres == pytest.approx([0.4], abs=0.02)
    # One deviation a match is 0.4 m to 0.09 m in one axis of three, and turns add to these.
    assert 2.0 < one.deviations[0] < 0.4 / (0.02 * np.sqrt(20)) / np.sqrt(3) + 0.1


def test_stretches_do_not_reach_over_a_chain_that_is_broken():
    matches = [matched(place, STEP) for place in range(40) if place != 10]
    (one,) = stretches(matches, poses(41))
    assert one.stamps.tolist() == [round(3.1 * NANOSECONDS)]


def test_a_lidar_with_less_than_a_stretch_is_left_out():
    assert stretches([matched(place, STEP) for place in range(10)], poses(11)) == []
