"""Fixes in the local frame, which of them are trusted, and the antenna's lever arm."""

import gtsam
import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.config import GnssSettings
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.gnss import (
    Datum,
    align_track,
)
from incremental_mapper.graph.factors import gnss_factor, pose_prior, pose_sigmas
from incremental_mapper.measurements import FixStatus, GnssFix
from incremental_mapper.smoothing.batch import squared_error
from incremental_mapper.variables import pose_key

DATUM = Datum(36.5, 127.25, 50.0)
SETTINGS = GnssSettings()


def fix(latitude=36.5, longitude=127.25, altitude=50.0, covariance=None, status=FixStatus.GBAS):
    return GnssFix(1, 'gps', latitude, longitude, altitude, status, covariance)


def radii(latitude):
    """Radii of the WGS-84 ellipsoid along the meridian and across it, from the textbook."""
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    w = 1 - e2 * np.sin(np.radians(latitude)) ** 2
    return a * (1 - e2) / w**1.5, a / np.sqrt(w)


def test_local_frame_is_east_north_up_in_metres():
    meridian, normal = radii(36.5)
    step = np.radians(1e-4)
    east = DATUM.enu(fix(longitude=127.25 + 1e-4))
    north = DATUM.enu(fix(latitude=36.5 + 1e-4))
    up = DATUM.enu(fix(altitude=53.0))
    assert east == pytest.approx([step * (normal + 50) * np.cos(np.radians(36.5)), 0, 0], abs=1e-3)
    assert north == pytest.approx([0, step * (meridian + 50), 0], abs=1e-3)
    assert up == pytest.approx([0, 0, 3], abs=1e-6)
    assert DATUM.enu(fix()) == pytest.approx(np.zeros(3), abs=1e-9)


@given(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-50, 50))
def test_positions_come_back_from_latitude_and_longitude(east, north, up):
    place = pymap3d.enu2geodetic(east, north, up, 36.5, 127.25, 50.0)
    assert DATUM.enu(fix(*map(float, place))) == pytest.approx([east, north, up], abs=1e-5)


tracks = st.lists(
    st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-5, 5)), min_size=2, max_size=12
).filter(lambda track: np.ptp(np.array(track)[:, :2], axis=0).max() > 1.0)
places = st.tuples(*[st.floats(-1000, 1000)] * 3)


@given(tracks, st.floats(-3.1, 3.1), places)
def test_turn_and_shift_of_a_track_are_recovered(track, yaw, shift):
    local = np.array(track)
    turn = gtsam.Rot3.Yaw(yaw).matrix()
    found_yaw, found_shift = align_track(local @ turn.T + np.array(shift), local)
    assert found_yaw == pytest.approx(yaw, abs=1e-7)
    assert found_shift == pytest.approx(shift, abs=1e-4)


def test_turn_of_a_noisy_track_is_the_least_squares_one():
    rng = np.random.default_rng(4)
    local = rng.normal(scale=20, size=(30, 3))
    enu = local @ gtsam.Rot3.Yaw(0.5).matrix().T + rng.normal(scale=0.5, size=(30, 3))
    yaw, shift = align_track(enu, local)

    def cost(angle):
        turned = local @ gtsam.Rot3.Yaw(angle).matrix().T
        error = enu - turned
        return float(np.sum((error - error.mean(axis=0)) ** 2))

    assert all(cost(yaw) <= cost(yaw + step) for step in (-1e-3, -1e-5, 1e-5, 1e-3))
    residual = enu - (local @ gtsam.Rot3.Yaw(yaw).matrix().T + shift)
    assert residual.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)


sigmas = st.floats(1e-4, 9.0)


@given(sigmas, sigmas, sigmas, st.floats(-3.1, 3.1))
def test_covariance_is_raised_to_the_floor_in_every_direction_and_no_further(a, b, c, yaw):
    turn = gtsam.Rot3.Yaw(yaw).matrix()
    reported = turn @ np.diag([a**2, b**2, c**2]) @ turn.T
    used = checked_covariance(fix(covariance=reported), SETTINGS)
    expected = turn @ np.diag(np.maximum([a, b, c], SETTINGS.min_sigma) ** 2) @ turn.T
    assert used == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_fix_of_unknown_covariance_gets_the_default():
    used = checked_covariance(fix(), GnssSettings(default_sigma=1.5))
    assert used.tolist() == (np.eye(3) * 1.5**2).tolist()


@pytest.mark.parametrize(
    ('status', 'least', 'used'),
    [
        (FixStatus.NO_FIX, 0, False),
        (FixStatus.FIX, 0, True),
        (FixStatus.FIX, 1, False),
        (FixStatus.SBAS, 1, True),
        (FixStatus.SBAS, 2, False),
        (FixStatus.GBAS, 2, True),
    ],
)
def test_status_below_the_least_one_is_rejected(status, least, used):
    settings = GnssSettings(min_status=least)
    if used:
        assert checked_covariance(fix(status=status), settings).shape == (3, 3)
    else:
        with pytest.raises(MeasurementError, match='min_status') as caught:
            checked_covariance(fix(status=status), settings)
        assert caught.value.reason == 'low_status'


@pytest.mark.parametrize('axis', [0, 1])
def test_uncertain_fix_is_rejected_by_its_worse_horizontal_axis(axis):
    reported = np.diag([1.0, 1.0, 1.0])
    reported[axis, axis] = 10.5**2
    with pytest.raises(MeasurementError, match='max_sigma') as caught:
        checked_covariance(fix(covariance=reported), SETTINGS)
    assert caught.value.reason == 'too_uncertain'


def test_height_may_be_uncertain():
    reported = np.diag([1.0, 1.0, 400.0])
    assert checked_covariance(fix(covariance=reported), SETTINGS) == pytest.approx(reported)


def error_at(factor, pose):
    values = gtsam.Values()
    values.insert(pose_key(0), pose)
    return squared_error([factor.factor], values)


@given(st.floats(-3.1, 3.1), st.floats(-1, 1), places, st.tuples(*[st.floats(-2, 2)] * 3))
def test_antenna_sits_at_the_lever_arm_in_base_link(yaw, pitch, place, arm):
    rotation = gtsam.Rot3.Ypr(yaw, pitch, 0.1)
    antenna = np.array(place) + rotation.matrix() @ np.array(arm)
    factor = gnss_factor(pose_key(0), antenna, np.eye(3) * 0.01, np.array(arm), 0.0, 'gps', 5)
    assert error_at(factor, gtsam.Pose3(rotation, np.array(place))) == pytest.approx(0, abs=1e-9)


def test_antenna_ahead_of_a_car_that_looks_north_is_north_of_it():
    looks_north = gtsam.Pose3(gtsam.Rot3.Yaw(np.pi / 2), np.zeros(3))
    arm = np.array([2.0, 0.0, 0.0])
    covariance = np.diag([0.01, 0.04, 0.09])
    right = gnss_factor(pose_key(0), np.array([0.0, 2.0, 0.0]), covariance, arm, 0.0, 'gps', 5)
    wrong = gnss_factor(pose_key(0), np.array([0.0, -2.0, 0.0]), covariance, arm, 0.0, 'gps', 5)
    assert error_at(right, looks_north) == pytest.approx(0, abs=1e-12)
    assert error_at(wrong, looks_north) == pytest.approx(4.0**2 / 0.04)


def test_robust_loss_grows_linearly_beyond_its_threshold():
    def error(distance, threshold):
        factor = gnss_factor(
            pose_key(0), np.array([distance, 0.0, 0.0]), np.eye(3), np.zeros(3), threshold, 'g', 1
        )
        return error_at(factor, gtsam.Pose3())

    assert error(2.0, 3.0) == pytest.approx(error(2.0, 0.0)) == pytest.approx(4.0)
    assert error(10.0, 0.0) == pytest.approx(100.0)
    assert error(10.0, 3.0) == pytest.approx(2 * 3.0 * 10.0 - 3.0**2)


def test_pose_sigmas_put_rotation_first():
    assert pose_sigmas(0.3, 0.02).tolist() == [0.02] * 3 + [0.3] * 3
    prior = pose_prior(pose_key(0), gtsam.Pose3(), pose_sigmas(0.5, 0.1), 0)
    shifted = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 1.0, 0.0]))
    turned = gtsam.Pose3(gtsam.Rot3.Yaw(0.3), np.zeros(3))
    assert error_at(prior, shifted) == pytest.approx((1.0 / 0.5) ** 2)
    assert error_at(prior, turned) == pytest.approx((0.3 / 0.1) ** 2)


def test_a_fix_that_says_that_it_errs_by_metres_turns_no_track():
    local = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    enu = local @ gtsam.Rot3.Yaw(0.5).matrix().T
    enu[0] += [1.5, -1.5, 0.0]
    assert abs(align_track(enu, local)[0] - 0.5) > 0.1
    yaw, _ = align_track(enu, local, np.array([2.0, 0.02, 0.02]))
    assert yaw == pytest.approx(0.5, abs=1e-3)
    alike = align_track(enu, local, np.full(3, 0.3))
    assert alike[0] == pytest.approx(align_track(enu, local)[0])
