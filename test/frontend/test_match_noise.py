"""A match is as uncertain as the scans leave it, direction by direction, in the scan's frame."""

import gtsam
import numpy as np
import pytest
from driven_room import STEP, front_end, poses, room, scan, seen_from

from incremental_mapper.config import OdometrySettings
from incremental_mapper.frontend.match_noise import carried, weak_directions
from incremental_mapper.frontend.registration import make_matcher

TURN = gtsam.Pose3(gtsam.Rot3.Yaw(0.6), np.array([0.3, 0.1, 0.0]))


def ground(rng):
    """Points (N, 3) of uneven ground around a car, metres."""
    points = rng.uniform(-20.0, 20.0, size=(3000, 3))
    points[:, 2] = rng.normal(scale=0.01, size=3000) - 2.0
    return points


def wall_along_x(rng):
    points = rng.uniform(-20.0, 20.0, size=(3000, 3))
    points[:, 1] = rng.normal(scale=0.01, size=3000) + 8.0
    points[:, 2] = 0.1 * points[:, 2] + 0.0
    return points


def match(scene, motion, **settings):
    """The match of two scans of a scene, each with points of its own, from a perfect guess."""
    matcher = make_matcher(OdometrySettings(**settings))
    rng = np.random.default_rng(4)
    matcher.match(scene(rng), gtsam.Pose3())
    return matcher.match(seen_from(motion, scene(rng)), motion)


def sigmas(covariance):
    return np.sqrt(np.diag(covariance))


def test_bare_ground_holds_height_and_level_and_neither_way_nor_yaw():
    found = sigmas(match(ground, STEP).covariance)
    assert (found[[2, 3, 4]] > [0.02, 0.3, 0.3]).all()
    assert (found[[0, 1, 5]] < [0.003, 0.003, 0.03]).all()


def test_a_room_holds_a_match_from_all_sides():
    covariance = match(lambda rng: room(seed=int(rng.integers(99))), STEP).covariance
    assert (sigmas(covariance) < [0.004] * 3 + [0.03] * 3).all()
    assert weak_directions(covariance) == 0


def test_what_a_wall_leaves_open_is_told_in_the_frame_of_the_current_scan():
    def scene(rng):
        return np.vstack([ground(rng), wall_along_x(rng)])

    covariance = match(scene, TURN).covariance
    assert weak_directions(covariance) == 1
    along = TURN.rotation().unrotate(np.array([1.0, 0.0, 0.0]))
    variances, axes = np.linalg.eigh(covariance[3:, 3:])
    assert abs(axes[:, -1] @ along) > 0.99
    assert variances[-1] > 100.0 * variances[-2]


def test_noise_of_the_ground_is_no_hold():
    def rough(rng):
        points = ground(rng)
        points[:, 2] = rng.normal(scale=0.06, size=len(points)) - 2.0
        return points

    found = sigmas(match(rough, STEP, covariance_scale=2.5).covariance)
    assert (found[[3, 4]] > 0.3).all()


def test_a_hold_that_may_all_be_noise_is_believed_no_more_for_being_larger():
    def rough(rng):
        points = ground(rng)
        points[:, 2] = rng.normal(scale=0.25, size=len(points)) - 2.0
        return points

    surest = {'covariance_scale': 1e-3, 'floor_rotation': 1e-9, 'floor_translation': 1e-9}
    rugged = sigmas(match(rough, STEP, **surest).covariance)
    held = sigmas(match(lambda rng: room(seed=int(rng.integers(99))), STEP, **surest).covariance)
    assert (rugged[[3, 4]] > 0.14).all()
    assert (held[3:] < 0.003).all()


def test_an_error_along_the_ground_lifts_and_tilts_a_match_by_a_part_of_it():
    held, bare = (
        sigmas(match(scene, STEP, covariance_scale=2.5).covariance)
        for scene in (lambda rng: room(seed=int(rng.integers(99))), ground)
    )
    assert (bare[[0, 1, 5]] > 0.01 * bare[3] * np.array([0.08, 0.08, 1.0])).all()
    assert (bare[[0, 1, 5]] > 2.0 * held[[0, 1, 5]]).all()


def test_points_on_one_line_tell_nothing_of_turns_about_it():
    def line(rng):
        return np.column_stack([rng.uniform(-20.0, 20.0, 3000), np.zeros((3000, 2))])

    covariance = match(line, STEP, covariance_scale=2.5).covariance
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert sigmas(covariance)[0] > 0.5


def test_scale_and_floor_are_those_of_the_settings():
    plain, floor = {'floor_rotation': 1e-9, 'floor_translation': 1e-9}, np.array([0.002, 0.02])
    once, twice, thrice, higher = (
        match(lambda rng: room(seed=int(rng.integers(99))), STEP, **settings).covariance
        for settings in (
            {'covariance_scale': 4.0, **plain},
            {'covariance_scale': 8.0, **plain},
            {'covariance_scale': 12.0, **plain},
            {'covariance_scale': 4.0, 'floor_rotation': floor[0], 'floor_translation': floor[1]},
        )
    )
    assert thrice - twice == pytest.approx(twice - once, rel=1e-6)
    assert np.diag(twice) == pytest.approx(2.0 * np.diag(once), rel=0.05)
    assert higher - once == pytest.approx(np.diag(np.repeat(floor, 3) ** 2), rel=1e-6)


def test_constant_noise_leaves_the_matcher_silent():
    assert match(ground, STEP, noise='constant').covariance is None
    assert match(ground, STEP, method='kiss_icp').covariance is None


def test_a_carried_covariance_is_what_samples_of_the_motion_have():
    rng = np.random.default_rng(5)
    root = 0.02 * rng.normal(size=(6, 6))
    T_frame_scan = gtsam.Pose3(gtsam.Rot3.Ypr(0.4, -0.2, 0.1), np.array([3.0, -2.0, 1.0]))
    there = STEP.compose(T_frame_scan.inverse())
    apart = [
        there.localCoordinates(STEP.retract(root @ drawn).compose(T_frame_scan.inverse()))
        for drawn in rng.normal(size=(20_000, 6))
    ]
    measured, told = np.cov(np.array(apart).T), carried(root @ root.T, T_frame_scan)
    assert np.abs(measured - told).max() < 0.04 * np.abs(told).max()


def prepared_on(scene, motion_scans=3):
    end = front_end()
    rng = np.random.default_rng(6)
    found = []
    for number, pose in enumerate(poses(motion_scans)):
        found += end.prepare((scan(0.1 * number, seen_from(pose, scene(rng))),))
    return end, found


def test_a_scan_has_the_covariance_of_its_match_and_weak_ones_are_counted():
    end, found = prepared_on(ground)
    assert found[0].covariance is None
    assert all(weak_directions(item.covariance) == 3 for item in found[1:])
    assert end.notes == {'left: held weakly in some direction': 2}
    end, found = prepared_on(lambda rng: room(seed=int(rng.integers(99))))
    assert found[2].covariance is not None and not end.notes
