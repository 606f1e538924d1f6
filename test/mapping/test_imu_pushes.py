"""Samples that gather a speed which no match knows of are doubted, and no others."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.imu_pushed import Pushes, pushed_findings
from incremental_mapper.config import ImuSettings
from incremental_mapper.frontend.imu_preintegration import (
    ImuSeries,
    preintegrate,
    preintegration_parameters,
)
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.mapping.imu_pushes import ImuPushes

MS = 1_000_000
EPOCH = 1_700_000_000_000_000_000
RATE, AHEAD, SPEED = 0.3, 2.0, 5.0
"""A car that turns by rad/s, and goes faster by m/s^2 from so many m/s on."""


def samples(pushed, since, until, seconds=8.0, turned=None):
    """Samples at 100 Hz; one that is ``pushed`` (3,) from ``since`` until ``until``, seconds."""
    moments = np.arange(round(100 * seconds)) * 0.01
    speed = SPEED + AHEAD * moments
    force = np.column_stack(
        [np.full_like(moments, AHEAD), speed * RATE, np.full_like(moments, 9.81)]
    )
    force[(moments >= since) & (moments < until)] += pushed
    gyro = np.tile([0.0, 0.0, RATE], (len(moments), 1))
    turned = np.eye(3) if turned is None else turned
    stamps = EPOCH + np.rint(moments * 1000).astype(np.int64) * MS
    return ImuSeries(stamps, gyro @ turned, force @ turned)


def match(number, covariance=None):
    """The match of the scans at ``number`` and ``number`` - 1 tenths of a second."""
    start, empty = 0.1 * (number - 1), np.zeros((0, 3))
    steps = start + (np.arange(100) + 0.5) * 0.001
    angles = RATE * (steps - start)
    ways = (SPEED + AHEAD * steps) * 0.001
    shift = [float(ways @ np.cos(angles)), float(ways @ np.sin(angles)), 0.0]
    motion = gtsam.Pose3(gtsam.Rot3.Rz(0.1 * RATE), np.array(shift))
    stamps = [EPOCH + n * 100 * MS for n in (number - 1, number)]
    core = CoreMeasurement(stamps[1], 'left', CoreKind.LIDAR)
    return PreparedScan(core, empty.astype(np.float32), empty, stamps[0], motion, True, covariance)


def doubted(series, T_base_imu=None, covariance=None, pushes=None):
    """Seconds of the samples that are doubted, window by window, as spans would use them up."""
    pushes = pushes or ImuPushes(np.eye(4) if T_base_imu is None else T_base_imu)
    found = []
    for number in range(1, len(series.stamps) // 10):
        window = series.part(10 * number - 10, 10 * number + 1)
        taken = pushes.take(window, [match(number, covariance)])
        found += ((taken.stamps[taken.all_doubts() > 0.0] - EPOCH) / 1e9).tolist()
    return np.array(found)


@pytest.mark.parametrize('pushed', [[3.0, 0.0, 0.0], [0.0, -3.0, 0.0], [0.0, 0.0, 6.0]])
def test_a_push_is_doubted_while_it_lasts(pushed):
    found = doubted(samples(pushed, 5.0, 6.5))
    assert len(found) and found.min() > 4.8
    assert found.max() < 7.3
    inside = np.unique(found[(found > 5.3) & (found < 6.5)].round(2))
    assert len(inside) >= 118  # of 120 samples


def test_a_car_that_turns_and_speeds_up_is_believed():
    assert len(doubted(samples([0.0, 0.0, 0.0], 0.0, 0.0))) == 0


@pytest.mark.parametrize(('sigma', 'accused'), [(0.065, False), (0.01, True)])
def test_matches_that_slip_and_know_it_accuse_nobody(sigma, accused):
    series, pushes, found = samples([0.0, 0.0, 0.0], 0.0, 0.0), ImuPushes(np.eye(4)), 0
    for number in range(1, len(series.stamps) // 10):
        sound = match(number, np.eye(6) * 0.01**2)
        slipped = number in (50, 51)
        if slipped:
            motion = sound.T_previous_current
            further = gtsam.Pose3(motion.rotation(), motion.translation() + [0.4, 0.0, 0.0])
            sound = replace(
                sound, T_previous_current=further, covariance=np.diag([1e-6] * 3 + [sigma**2] * 3)
            )
        taken = pushes.take(series.part(10 * number - 10, 10 * number + 1), [sound])
        found += int((taken.all_doubts() > 0.0).sum())
    assert (found > 0) is accused


def test_an_imu_that_stands_on_its_side_is_held_against_its_own_place():
    turned = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    T_base_imu = np.eye(4)
    T_base_imu[:3, :3] = turned
    assert len(doubted(samples([0.0] * 3, 0.0, 0.0, turned=turned), T_base_imu)) == 0
    assert len(doubted(samples([3.0, 0.0, 0.0], 5.0, 6.5, turned=turned), T_base_imu))


def test_a_bias_that_stays_is_learned_and_not_doubted_for_ever():
    found = doubted(samples([3.0, 0.0, 0.0], 5.0, 20.0, seconds=20.0))
    # It goes round in the axes that gravity is learned in, so that it takes longer.
    assert len(found) and found.max() < 15.0


def test_matches_that_hold_weakly_say_nothing_against_the_imu():
    weak = np.diag([1e-6] * 3 + [25.0, 1e-4, 1e-4])
    assert len(doubted(samples([3.0, 0.0, 0.0], 5.0, 6.5), covariance=weak)) == 0


def test_a_slow_imu_is_accused_of_nothing():
    series = samples([3.0, 0.0, 0.0], 5.0, 6.5)
    slow = series.chosen(np.arange(len(series.stamps)) % 10 == 0)
    pushes = ImuPushes(np.eye(4))
    for number in range(1, 80):
        pushes.take(slow.part(number - 1, number + 2), [match(number)])
    assert pushes.told.count == 0


def test_a_span_of_doubted_samples_is_believed_less():
    settings = ImuSettings()
    parameters = preintegration_parameters(settings, np.eye(4))
    plain = samples([0.0] * 3, 0.0, 0.0, seconds=0.2)
    doubts = ImuSeries(
        plain.stamps, plain.gyro, plain.acceleration, doubts=np.full(len(plain.stamps), 15.0)
    )
    spans = [
        preintegrate(each, EPOCH, EPOCH + 100 * MS, parameters, gtsam.imuBias.ConstantBias())
        for each in (plain, doubts.joined_series(plain.part(0, 0)).part(0, 20))
    ]
    sigmas = [np.sqrt(span.preintMeasCov()[6, 6]) for span in spans]
    assert sigmas[1] == pytest.approx(1.5, rel=0.1)  # 15 m/s^2 over 0.1 s
    assert sigmas[0] < 0.1


def test_a_push_is_counted_and_told():
    pushes = ImuPushes(np.eye(4))
    found = np.unique(doubted(samples([3.0, 0.0, 0.0], 5.0, 6.5), pushes=pushes))
    told = pushes.told
    assert told.count == 1 and told.most == pytest.approx(1.7, abs=0.1)
    assert told.seconds == pytest.approx(np.ptp(found), abs=0.02)
    assert (told.stamp - EPOCH) / 1e9 == pytest.approx(found.min(), abs=0.01)
    (finding,) = pushed_findings(told)
    assert (finding.rule, finding.severity) == ('imu_pushed', Severity.MENDED)
    assert f'for {told.seconds:.1f} s it gathers' in finding.text
    assert str(told.stamp) in finding.text


def test_spells_that_meet_are_one_and_slight_ones_are_not_told():
    pushes = Pushes()
    pushes.add(1_000 * MS, 1_500 * MS, 0.7)
    pushes.add(1_100 * MS, 1_600 * MS, 0.8)
    pushes.add(5_000 * MS, 5_500 * MS, 0.75)
    assert (pushes.count, pushes.stamp) == (2, 1_000 * MS)
    assert pushes.seconds == pytest.approx(1.1)
    assert pushed_findings(pushes) == () == pushed_findings(Pushes())
    pushes.add(5_300 * MS, 5_900 * MS, 1.5)
    assert pushes.stamp == 5_000 * MS
    assert '2 times' in pushed_findings(pushes)[0].text
