"""An IMU beside scan matching: unit of the rates, clock, axes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imu_rig import GRAVITY, evidence, quarter

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.imu_beside_lidar import check_motion
from incremental_mapper.checks.imu_motion import QUARTER_TURNS, compare_axes
from incremental_mapper.config import Imu


def only(found):
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('last', [False, True])
def test_nothing_is_said_of_a_good_imu(seed, last):
    assert check_motion(evidence(seed=seed), Imu(), last) == ()


def test_degrees_are_known_by_the_ratio_of_the_rotations():
    found = only(check_motion(evidence(rate=180 / np.pi), Imu()))
    assert (found.rule, found.severity) == ('imu_in_deg', Severity.MENDED)
    scale = found.settings['imu']['rate_scale']
    assert scale == pytest.approx(np.pi / 180, rel=1e-4)
    mended = Imu(rate_scale=scale)
    assert check_motion(evidence(rate=180 / np.pi, settings=mended), mended) == ()


@pytest.mark.parametrize('unit', [9.80665, 0.00980665])
def test_accelerations_without_gravity_are_held_against_those_of_the_matches(unit):
    sound = evidence(seconds=20.0)
    bare = replace(sound, force=sound.force - (0.0, 0.0, GRAVITY), gravity=0.0)
    assert check_motion(bare, Imu()) == ()
    found = only(check_motion(replace(bare, force=bare.force / unit), Imu()))
    assert (found.rule, found.severity) == ('imu_in_g', Severity.MENDED)
    assert found.settings['imu']['acceleration_scale'] == pytest.approx(unit)
    noise = np.random.default_rng(3).normal(scale=0.1, size=bare.force.shape)
    assert check_motion(replace(bare, force=noise), Imu()) == ()  # has nothing to do with it


def test_raw_counts_of_a_gyroscope_are_scaled():
    found = only(check_motion(evidence(rate=7509.9), Imu()))
    assert (found.rule, found.severity) == ('imu_rate_scale', Severity.MENDED)
    assert found.settings['imu']['rate_scale'] == pytest.approx(1 / 7509.9, rel=0.1)


@pytest.mark.parametrize('late', [0.15, -0.2, 1.2])
def test_a_clock_that_is_off_is_shifted_back(late):
    found = only(check_motion(evidence(late=late), Imu()))
    assert (found.rule, found.severity) == ('imu_clock', Severity.MENDED)
    assert found.settings['imu']['time_offset'] == pytest.approx(-late, abs=0.01)


def test_half_a_sweep_is_no_fault_of_the_clock():
    assert check_motion(evidence(late=0.06), Imu()) == ()


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(list(QUARTER_TURNS[1:])), st.sampled_from([1, -1]))
def test_axes_are_found_and_mended(turn, sign):
    # Where axes or signs are wrong, this way of them is the only one that fits.
    found = only(check_motion(evidence(turn=turn, force=sign), Imu()))
    assert (found.rule, found.severity) == ('imu_axes', Severity.MENDED)
    mended = Imu(**found.settings['imu'])
    np.testing.assert_allclose(mended.matrix()[:3, :3], turn, atol=1e-5)
    assert mended.acceleration_scale == sign
    assert check_motion(evidence(turn=turn, force=sign, settings=mended), mended, True) == ()


def test_gravity_of_the_wrong_sign_is_told_from_an_imu_that_hangs_upside_down():
    found = only(check_motion(evidence(force=-1), Imu()))
    assert (found.rule, found.settings) == ('imu_sign', {'imu': {'acceleration_scale': -1.0}})
    assert only(check_motion(evidence(turn=quarter('x', 180)), Imu())).rule == 'imu_axes'


def test_extrinsics_that_are_right_lead_whatever_they_are():
    turn = quarter('x', 90) @ quarter('z', 20)
    settings = Imu(T_base_sensor=[*np.column_stack([turn, [0.1, 0.2, 0.3]]).ravel()])
    assert check_motion(evidence(turn=turn, settings=settings), settings, True) == ()


def test_axes_between_those_of_base_link_are_told_and_the_imu_is_not_used():
    found = only(check_motion(evidence(turn=quarter('z', 40)), Imu()))
    assert (found.rule, found.severity) == ('imu_axes', Severity.WARNING)
    assert found.settings == {'imu': {'enabled': False}} and found.changes
    numbers = [float(value) for value in found.remedy.rpartition('[')[2].rstrip(']').split(',')]
    told = Imu(T_base_sensor=numbers).matrix()[:3, :3]
    assert np.degrees(np.arccos((np.trace(told @ quarter('z', -40)) - 1) / 2)) < 5


def test_where_gravity_is_right_the_lidars_may_be_wrong():
    good, turn = evidence(), quarter('y', 90)
    tilted = replace(good, turns=good.turns @ turn.T, shifts=good.shifts @ turn.T)
    found = only(check_motion(tilted, Imu()))
    assert (found.rule, found.severity) == ('imu_axes', Severity.WARNING)
    assert found.settings == {'imu': {'enabled': False}} and found.changes


def test_a_yaw_rate_of_the_wrong_sign_switches_the_imu_off():
    good = evidence(seconds=20.0)
    found = only(check_motion(replace(good, gyro=good.gyro * [1.0, 1.0, -1.0]), Imu()))
    assert (found.rule, found.severity) == ('imu_axes', Severity.WARNING)
    assert found.settings == {'imu': {'enabled': False}} and found.changes


def standing(force=1.0):
    good = evidence(force=force)
    noise = np.random.default_rng(0).normal(size=(2, *good.gyro.shape))
    return replace(
        good,
        turns=0.0003 * noise[0, : len(good.turns)],
        shifts=0.001 * noise[1, : len(good.turns)],
        gyro=0.003 * noise[0],
        force=force * (np.array([0.0, 0.0, GRAVITY]) + 0.05 * noise[1]),
    )


def test_without_gravity_nothing_is_upright_or_not():
    good = evidence()
    felt = replace(good, force=good.force - (0.0, 0.0, GRAVITY), gravity=0.0)
    assert check_motion(felt, Imu(), True) == ()


def test_a_car_that_stands_says_nothing_of_axes_and_clock():
    assert check_motion(standing(), Imu(), True) == ()
    axes = compare_axes(standing())
    assert axes.lead < 5


def test_gravity_upside_down_without_motion_switches_the_imu_off_at_last():
    assert check_motion(standing(-1.0), Imu()) == ()
    found = only(check_motion(standing(-1.0), Imu(), True))
    assert (found.rule, found.severity, found.changes) == (
        'imu_not_upright',
        Severity.WARNING,
        True,
    )


def test_a_gyroscope_that_has_nothing_to_do_with_the_car_is_switched_off():
    good = evidence()
    for gyro, rule in (
        (np.random.default_rng(0).normal(size=good.gyro.shape), 'imu_disagrees'),
        (np.zeros_like(good.gyro), 'imu_gyro_frozen'),
    ):
        bad = replace(good, gyro=gyro)
        found = only(check_motion(bad, Imu(), last=True))
        assert (found.rule, found.settings) == (rule, {'imu': {'enabled': False}})
        assert found.changes


def test_matches_that_are_mere_noise_prove_nothing_of_the_imu():
    good = evidence()
    noise = 0.01 * np.random.default_rng(0).normal(size=good.turns.shape)
    assert check_motion(replace(good, turns=noise), Imu(), last=True) == ()


def test_clocks_that_are_hours_apart_compare_nothing():
    assert check_motion(evidence(late=7200.0), Imu(), True) == ()


@pytest.mark.parametrize('rate', [0.5, 0.8, 1.4, 2.0])
def test_a_full_scale_that_is_set_wrong_is_found_where_the_car_turns(rate):
    found = only(check_motion(evidence(rate=rate, seconds=20.0), Imu()))
    assert (found.rule, found.severity) == ('imu_rate_scale', Severity.MENDED)
    assert found.settings['imu']['rate_scale'] == pytest.approx(1 / rate, rel=0.05)


def test_a_scale_that_noise_makes_is_none():
    for rate in (0.95, 1.05):
        assert check_motion(evidence(rate=rate, seconds=20.0), Imu()) == ()


@pytest.mark.parametrize(
    ('rates', 'said'),
    [
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], '(y, x, z)'),
        ([[-1, 0, 0], [0, 1, 0], [0, 0, 1]], '(-x, y, z)'),
        ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], 'contradict'),
    ],
)
def test_axes_of_the_gyroscope_alone_that_are_exchanged_are_told(rates, said):
    seen = evidence(seconds=20.0)
    mixed = replace(seen, gyro=seen.gyro @ np.array(rates, dtype=float))
    found = only(check_motion(mixed, Imu()))
    assert (found.rule, found.severity) == ('imu_axes', Severity.WARNING)
    assert found.settings == {'imu': {'enabled': False}}
    assert said in found.text
