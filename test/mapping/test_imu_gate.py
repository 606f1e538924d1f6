"""Samples that contradict the matches are left out, and no others."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.frontend.imu_preintegration import ImuSeries, turning_of
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.mapping.imu_gate import ImuGate, gate

MS = 1_000_000
EYE = np.eye(3)
SIDEWAYS = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def series(seconds=0.5, rate=0.3, turned=EYE):
    """A car that turns by ``rate`` about its upward axis, at 100 Hz."""
    count = round(100 * seconds)
    gyro = np.tile([0.0, 0.0, rate], (count, 1))
    force = np.tile([0.1, 0.0, 9.81], (count, 1))
    return ImuSeries(np.arange(count) * 10 * MS, gyro @ turned, force @ turned)


def match(number, rate=0.3, sensor='left'):
    """The match of the scans at ``number`` and ``number`` - 1 tenths of a second."""
    empty = np.zeros((0, 3))
    motion = gtsam.Pose3(gtsam.Rot3.Rz(0.1 * rate), gtsam.Point3(1.0, 0.0, 0.0))
    core = CoreMeasurement(number * 100 * MS, sensor, CoreKind.LIDAR)
    return PreparedScan(core, empty.astype(np.float32), empty, (number - 1) * 100 * MS, motion)


MATCHES = [match(number) for number in range(1, 6)]


@pytest.mark.parametrize('turned', [EYE, SIDEWAYS])
@pytest.mark.parametrize(('value', 'count'), [(15.0, 1), (30.0, 1), (75.0, 1), (20.0, 20)])
def test_rates_that_no_match_knows_of_are_left_out(turned, value, count):
    samples = series(turned=turned)
    samples.gyro[12 : 12 + count] = np.array([0.0, 0.0, value]) @ turned
    gated = gate(samples, MATCHES, turned)
    assert len(gated.refused.stamps) == count
    assert np.abs(gated.series.gyro).max() < 1.0
    assert len(gated.series.stamps) == len(gated.series.acceleration) == 50 - count


@pytest.mark.parametrize('count', [1, 10])
def test_forces_that_no_match_knows_of_are_left_out(count):
    samples = series()
    samples.acceleration[12 : 12 + count, 0] = 200.0
    gated = gate(samples, MATCHES, EYE)
    assert len(gated.refused.stamps) == count
    assert np.abs(gated.series.acceleration).max() < 10.0


@pytest.mark.parametrize('force', [35.0, 45.0])
def test_a_force_that_no_vehicle_feels_for_so_long_is_left_out_as_a_whole(force):
    samples = series()
    samples.acceleration[12:32, 0] += force
    gated = gate(samples, MATCHES, EYE)
    assert gated.refused.stamps.tolist() == samples.stamps[12:32].tolist()


def test_a_force_that_lasts_is_left_out_across_windows_and_ends_with_itself():
    held, samples = ImuGate(), series(1.0)
    held.take(samples.part(0, 50), MATCHES, EYE)
    samples.acceleration[20:75, 0] += 35.0
    assert len(held.take(samples.part(0, 70), MATCHES, EYE).refused.stamps) == 50
    # No match tells of the rest, but it goes on.
    gated = held.take(samples.part(70, 100), [], EYE)
    assert gated.refused.stamps.tolist() == samples.stamps[70:75].tolist()


def test_an_imu_that_is_turned_over_stays():
    held, samples = ImuGate(), series()
    held.take(samples, MATCHES, EYE)
    samples.acceleration[10:, 2] *= -1.2
    assert len(held.take(samples, MATCHES, EYE).refused.stamps) == 0


def test_a_jolt_that_comes_back_stays():
    samples = series()
    samples.acceleration[20:24, 2] += 45.0
    samples.acceleration[24:28, 2] -= 45.0
    assert len(gate(samples, MATCHES, EYE).refused.stamps) == 0


def test_a_turn_that_the_matches_see_as_well_stays():
    samples = series(rate=5.0)
    assert (
        len(gate(samples, [match(number, 5.0) for number in range(1, 6)], EYE).refused.stamps) == 0
    )


def test_a_match_that_is_wrong_costs_no_sample_that_turns_as_cars_do():
    wrong = [match(number, 8.0) for number in range(1, 6)]
    assert len(gate(series(), wrong, EYE).refused.stamps) == 0


def test_a_sample_that_another_lidar_vouches_for_stays():
    samples = series(rate=5.0)
    both = [*MATCHES, *(match(number, 5.0, 'right') for number in range(1, 6))]
    assert len(gate(samples, both, EYE).refused.stamps) == 0


def test_vibration_whose_mean_is_the_motion_stays():
    samples = series()
    samples.gyro[:, 0] += 6.0 * np.cos(np.pi * np.arange(50))
    samples.acceleration[:, 2] += 80.0 * np.cos(np.pi * np.arange(50))
    assert len(gate(samples, MATCHES, EYE).refused.stamps) == 0


def test_a_kerb_stays():
    samples = series()
    samples.acceleration[20:22, 2] += 45.0
    assert len(gate(samples, MATCHES, EYE).refused.stamps) == 0


def test_without_matches_nothing_is_known():
    samples = series()
    samples.gyro[12] = 30.0
    assert gate(samples, [], EYE).series is samples


@pytest.mark.parametrize(('gyro', 'force'), [(20.0, 0.0), (0.0, 100.0)])
def test_what_no_vehicle_does_so_long_is_left_out_without_matches(gyro, force):
    samples = series()
    samples.gyro[12:32, 2] += gyro
    samples.acceleration[12:32, 0] += force
    held = ImuGate()
    held.take(series(), MATCHES, EYE)
    gated = held.take(samples, [], EYE)
    assert gated.refused.stamps.tolist() == samples.stamps[12:32].tolist()


def test_a_whirl_that_matches_see_as_well_stays():
    samples = series(rate=12.0)
    assert len(gate(samples, [match(n, 12.0) for n in range(1, 6)], EYE).refused.stamps) == 0


def test_a_knock_that_fills_a_window_is_left_out_whole():
    held, usual = ImuGate(), series()
    assert len(held.take(usual, MATCHES, EYE).refused.stamps) == 0
    force = usual.acceleration.copy()
    force[5:45, 0] += 100.0
    gated = held.take(ImuSeries(usual.stamps, usual.gyro, force), MATCHES, EYE)
    assert gated.refused.stamps.tolist() == usual.stamps[5:45].tolist()
    # What comes after it is used again.
    assert len(held.take(usual, MATCHES, EYE).refused.stamps) == 0


def joined(samples):
    """A series with how the turn changes, as the mapper makes it of a window's samples."""
    told = turning_of(samples.stamps, samples.gyro)
    return replace(samples, turning=told)


@pytest.mark.parametrize('begins', [12, 43, 49], ids=['judged', 'in the last match', 'behind it'])
def test_a_knock_changes_no_turn_of_the_samples_beside_it(begins):
    samples = series()
    samples.gyro[begins : begins + 20, 2] = 20.0
    matches = MATCHES if begins < 49 else MATCHES[:4]
    gated = gate(joined(samples), matches, EYE)
    assert np.abs(gated.series.changes).max() < 1e-9
    assert len(gated.series.changes) == len(gated.series.stamps)


def test_a_fast_turn_that_a_later_match_vouches_for_is_told_in_full():
    count, begins = 60, 42
    samples = series(0.6, rate=0.0)
    samples.gyro[begins:, 2] = 4.0
    window = samples.part(0, 50)
    first = gate(joined(window), MATCHES[:4], EYE)
    assert not first.series.changes[begins - 4 :].any()
    newer = samples.part(50, count)
    both = first.series.joined_series(newer)
    both = replace(both, turning=turning_of(both.stamps, both.gyro, first.series.turning))
    later = gate(both, [*MATCHES[:4], match(5, 3.2), match(6, 4.0)], EYE)
    assert len(later.refused.stamps) == 0
    assert later.series.changes[:, 2].sum() * 0.01 == pytest.approx(4.0, abs=0.01)
