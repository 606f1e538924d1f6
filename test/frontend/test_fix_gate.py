"""Which fixes are used: those that agree with each other and with odometry."""

import gtsam
import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.checks.finding import Severity
from incremental_mapper.config import GnssSettings, OdometryMethod
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.fix_gate import FixGate
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS, FixStatus, GnssFix

START = 1_544_676_777_000_000_000
DATUM = (36.4, 129.0, 90.0)
HEADING = -1.16
SPEED = 5.0
SIGMA = 0.05


class Drive:
    """A car that drives straight on, seen by a LiDAR at 10 Hz and by a receiver."""

    def __init__(self, speed=SPEED, method=OdometryMethod.GICP, fixed=None):
        self.gate = FixGate(GnssSettings(), np.zeros(3), method, fixed)
        self.speed = speed
        self.covariance = None
        self.pitch = 0.0  # that odometry wrongly reads from scan to scan, rad
        self.scans = 0
        self.unmatched = frozenset()  # scans without a match to the one before
        self.used, self.doubtful, self.refused, self.gone = {}, set(), {}, set()
        self.rng = np.random.default_rng(1)

    def way(self, seconds):
        return self.speed * seconds

    def scan(self):
        stamp = START + self.scans * NANOSECONDS // 10
        begins = self.scans == 0 or self.scans in self.unmatched
        previous = None if begins else stamp - NANOSECONDS // 10
        step = self.way(self.scans / 10) - self.way((self.scans - 1) / 10)
        turn = gtsam.Rot3.Pitch(self.pitch)
        motion = None if begins else gtsam.Pose3(turn, np.array([step, 0, 0]))
        core = CoreMeasurement(stamp, 'left', CoreKind.LIDAR)
        nowhere, covariance = np.zeros((1, 3)), self.covariance if previous else None
        self.gate.scan(
            PreparedScan(core, nowhere, nowhere, previous, motion, covariance=covariance)
        )
        self.scans += 1

    def fix(self, number, seconds, off, noise=0.02, again=None):
        while self.scans / 10 <= seconds:
            self.scan()
        way = self.way(seconds) if again is None else self.way(again)
        place = np.array([np.cos(HEADING), np.sin(HEADING), 0.0]) * way + off
        place = place + (self.rng.normal(size=3) * noise if again is None else 0.0)
        latitude, longitude, altitude = map(float, pymap3d.enu2geodetic(*place, *DATUM))
        stamp = START + round(seconds * NANOSECONDS) + 1
        fix = GnssFix(stamp, 'gps', latitude, longitude, altitude, FixStatus.GBAS)
        try:
            judged = self.gate.fix(fix, np.eye(3) * SIGMA**2)
        except MeasurementError as error:
            self.refused[number] = error.reason
            return
        self.used[number] = judged
        if judged.doubtful:
            self.doubtful.add(number)
        refuted = self.gate.refuted
        if refuted:
            stamps = {
                START + round(i * seconds / max(number, 1) * NANOSECONDS) + 1: i for i in self.used
            }
            self.gone |= {stamps[one] for one in refuted}
            self.gate.refound()

    def rules(self):
        return {finding.rule for finding in self.gate.findings()}


def driven(count, period, off, **kwargs):
    drive = Drive(**kwargs)
    for i in range(count):
        drive.fix(i, i * period, np.asarray(off(i), dtype=float))
    return drive


def matches_read(drive, share):
    """Let scan matching read a share of the way that the fixes see."""
    true, scan = drive.way, drive.scan

    def part():
        drive.way = lambda seconds: share * true(seconds)
        scan()
        drive.way = true

    drive.scan = part


def off_datum(drive):
    """How far the datum is from the first right antenna position, across the way, metres."""
    datum = drive.gate.datum
    east, north, up = pymap3d.geodetic2enu(datum.latitude, datum.longitude, datum.altitude, *DATUM)
    return np.hypot(-np.sin(HEADING) * east + np.cos(HEADING) * north, up)


@pytest.mark.parametrize('method', OdometryMethod)
@pytest.mark.parametrize(('count', 'period'), [(60, 0.1), (60, 1.0), (2, 1.0), (300, 0.05)])
def test_fixes_of_a_sound_receiver_are_all_used_around_the_first_one(count, period, method):
    drive = driven(count, period, lambda i: [0, 0, 0], method=method)
    assert sorted(drive.used) == list(range(count))
    assert not drive.doubtful and not drive.gate.findings() and drive.gate.too_certain() is None
    assert drive.used[0].enu == pytest.approx(np.zeros(3), abs=1e-6)


@pytest.mark.parametrize('period', [0.1, 1.0])
@pytest.mark.parametrize('wrong', [1, 2])
def test_first_fixes_of_another_place_leave_the_graph(wrong, period):
    drive = driven(8, period, lambda i: [-9e4, 8e4, 0] if i < wrong else [0, 0, 0])
    assert drive.gone == set(range(wrong))
    assert drive.rules() == {'datum_outlier'}
    assert off_datum(drive) < 0.2
    assert 7 not in drive.doubtful


@pytest.mark.parametrize('period', [0.1, 1.0])
def test_single_jumps_are_refused(period):
    drive = driven(40, period, lambda i: [9000, 4000, 0] if i in (10, 25) else [0, 0, 0])
    assert drive.refused == {10: 'gnss_jump', 25: 'gnss_jump'}
    assert drive.rules() == {'gnss_jump'} and off_datum(drive) < 0.2


@given(
    st.sampled_from([0.1, 0.5, 1.0]),
    st.lists(st.tuples(*[st.floats(15, 500)] * 2), min_size=1, max_size=6),
)
@settings(max_examples=25, deadline=None)
def test_jumps_cost_the_jumps_only(period, jumps):
    wrong = {9 + 4 * k: [east, -north, 0.0] for k, (east, north) in enumerate(jumps)}
    drive = driven(45, period, lambda i: wrong.get(i, [0, 0, 0]))
    # Jumps by about the same agree with each other: they are no jumps any more, but a step.
    assert set(drive.refused) <= set(wrong)
    for number, judged in drive.used.items():
        assert not judged.doubtful
        assert judged.enu == pytest.approx(drive.used[0].enu + _way(number, period), abs=2.5)


def _way(number, period):
    return np.array([np.cos(HEADING), np.sin(HEADING), 0.0]) * SPEED * number * period


@pytest.mark.parametrize('period', [0.1, 1.0])
@pytest.mark.parametrize(('half', 'kept'), [(30, 0.0), (15, 100.0)])
def test_fixes_after_a_step_of_the_datum_are_moved_back_and_the_larger_part_tells_it(
    half, kept, period
):
    drive = driven(60, period, lambda i: [60, 80, 0] if i >= half + 1 else [0, 0, 0])
    assert set(drive.refused) == set(range(half + 1, half + 5))
    assert drive.rules() == {'gnss_jump', 'datum_step'}
    last = drive.used[59].enu - drive.used[0].enu
    assert last == pytest.approx(_way(59, period), abs=0.5)
    datum = drive.gate.datum
    place = pymap3d.geodetic2enu(datum.latitude, datum.longitude, datum.altitude, *DATUM)
    assert np.hypot(*place[:2]) == pytest.approx(kept, abs=0.5)


@pytest.mark.parametrize('period', [0.1, 1.0])
def test_heights_of_another_datum_are_moved_back_or_left_out(period):
    drive = driven(40, period, lambda i: [0, 0, -31.0 if i % 2 else 0.0])
    assert not drive.refused and drive.rules() == {'altitude_jump'}
    for number, judged in drive.used.items():
        assert abs(judged.enu[2]) < 0.3 or judged.covariance[2, 2] > 1e6
        if number > 8:
            assert judged.covariance[2, 2] == pytest.approx(SIGMA**2)


def test_heights_are_right_where_odometry_has_lost_its_level():
    """Scan matching on bare ground pitches by a fraction of a degree a second, and adds it up."""
    drive = Drive(speed=10.0)
    drive.pitch = 0.0005
    for i in range(90):
        drive.fix(i, float(i), np.zeros(3))
    assert not drive.refused and drive.rules() == set()
    assert all(judged.covariance[2, 2] == pytest.approx(SIGMA**2) for judged in drive.used.values())


def test_frozen_receiver_is_refused_while_the_car_moves_and_used_again_afterwards():
    drive = Drive()
    for i in range(40):
        drive.fix(i, i * 0.5, np.zeros(3), again=5.0 if 10 < i < 25 else None, noise=0.0)
    assert set(drive.refused) == set(range(11, 25))
    assert set(drive.refused.values()) == {'frozen_fix'} and drive.rules() == {'frozen_fix'}


def test_receiver_that_repeats_itself_while_the_car_stands_is_right():
    drive = Drive(speed=0.0)
    for i in range(100):
        drive.fix(i, i * 1.0, np.zeros(3), noise=0.0)
    assert not drive.refused and not drive.gate.findings()


@pytest.mark.parametrize('period', [0.1, 1.0])
def test_receiver_that_converges_is_believed_once_it_has(period):
    slow = 8.0 if period < 1.0 else 4.0
    drive = driven(80, period, lambda i: np.array([30, -20, 5]) * np.exp(-i / slow))
    assert {0, 1, 2} <= drive.gone
    # What is left is what a car may do unseen from one fix to the next.
    assert off_datum(drive) < (2.5 if period < 1.0 else 5.0)
    assert 79 in drive.used and not drive.used[79].doubtful
    assert drive.rules() >= {'datum_outlier'}


def test_covariances_that_are_far_too_small_are_found_out():
    rng = np.random.default_rng(4)
    offs = rng.normal(size=(40, 3)) * 2.5
    found = None
    drive = Drive()
    for i in range(40):
        drive.fix(i, i * 1.0, offs[i])
        found = found or drive.gate.too_certain()
    assert found is not None and found.rule == 'optimistic_covariance'
    assert found.settings['fixes']['min_sigma'] == pytest.approx(2.5, abs=1.3)


def test_converging_and_stepping_receivers_do_not_scatter():
    for off in (
        lambda i: np.array([30, -20, 5]) * np.exp(-i / 8.0),
        lambda i: np.array([60, 80, 0]) * (i > 12),
        lambda i: np.array([60, 80, 0]) * (i % 2),
    ):
        for period in (0.1, 1.0):
            drive = Drive()
            for i in range(40):
                drive.fix(i, i * period, off(i))
                assert drive.gate.too_certain() is None


def test_matcher_that_reads_hardly_any_motion_does_not_make_sound_fixes_jumps():
    drive = Drive(method=OdometryMethod.KISS_ICP)
    drive.way = lambda seconds: 0.8 * seconds**2  # what fixes see
    matches_read(drive, 0.3)
    for i in range(10):
        drive.fix(i, float(i), np.zeros(3))
    assert not drive.refused and not drive.doubtful and not drive.gate.findings()


@pytest.mark.parametrize(('sigma', 'loose'), [(0.3, True), (0.03, False)])
def test_matches_that_the_scans_hold_weakly_make_no_fix_a_jump(sigma, loose):
    drive = Drive()
    for i in range(20):
        # The fixes creep away from the matches by 2.5 m a second, now here, now there.
        aside = [0.0, 2.5 * (i % 3), 0.0]
        drive.covariance = np.diag([1e-5] * 3 + [sigma**2] * 2 + [1e-4])
        drive.fix(i, float(i), np.asarray(aside))
    assert (not drive.refused and not drive.gone) is loose


def test_weak_matches_that_lean_to_one_side_make_no_fix_doubtful():
    drive = Drive()
    matches_read(drive, 0.6)
    drive.covariance = np.diag([1e-5] * 3 + [0.2**2] * 2 + [1e-4])
    for i in range(25):
        drive.fix(i, float(i), np.zeros(3))
    assert not drive.refused and not drive.gone
    assert not {i for i in drive.doubtful if i > 5}


def test_fixes_without_any_odometry_are_used():
    drive = Drive()
    drive.scan = lambda: setattr(drive, 'scans', drive.scans + 1)
    for i in range(20):
        drive.fix(i, i * 1.0, np.zeros(3))
    assert not drive.refused


def place_from(datum, east):
    """The place that lies ``east`` metres to the east of another one."""
    return Datum(*map(float, pymap3d.enu2geodetic(east, 0.0, 0.0, *datum)))


def test_fixes_are_taken_around_a_fixed_datum():
    fixed = place_from(DATUM, -1500.0)
    drive = driven(40, 0.2, lambda i: [0, 0, 0], fixed=fixed)
    assert drive.gate.datum == fixed and not drive.gate.findings()
    for number, judged in drive.used.items():
        way = np.array([np.cos(HEADING), np.sin(HEADING), 0.0]) * drive.way(number * 0.2)
        there = pymap3d.geodetic2enu(*pymap3d.enu2geodetic(*way, *DATUM), *vars_of(fixed))
        # The planes at the two places are turned against each other, so a shift is not enough.
        assert judged.enu == pytest.approx(there, abs=0.1)


def vars_of(datum):
    return datum.latitude, datum.longitude, datum.altitude


@pytest.mark.parametrize('period', [0.1, 1.0])
def test_first_fixes_of_another_place_leave_the_graph_around_a_fixed_datum_too(period):
    fixed = place_from(DATUM, -1500.0)
    drive = driven(60, period, lambda i: [0, 0, 0] if i > 1 else [80, 50, 4], fixed=fixed)
    assert drive.gone == {0, 1} and drive.rules() == {'datum_outlier'}
    assert drive.gate.datum == fixed and drive.gate.certain


def test_fixes_after_a_step_are_moved_back_to_a_fixed_datum():
    fixed = place_from(DATUM, -1500.0)
    drive = driven(60, 0.5, lambda i: [0, 0, 0] if i < 20 else [8, -6, 0], fixed=fixed)
    assert 'datum_step' in drive.rules() and drive.gate.datum == fixed
    assert np.hypot(*drive.gate.steps[0].shift[:2]) == pytest.approx(10.0, abs=1.0)


@pytest.mark.parametrize(
    ('east', 'rules', 'severities', 'used'),
    [
        (4_000.0, set(), set(), 10),
        (8_000.0, {'far_datum'}, {Severity.WARNING}, 10),
        (80_000.0, {'far_datum'}, {Severity.ERROR}, 0),
    ],
)
def test_a_datum_that_is_far_away_is_warned_of_and_refused_beyond_reach(
    east, rules, severities, used
):
    drive = driven(10, 1.0, lambda i: [0, 0, 0], fixed=place_from(DATUM, east))
    assert drive.rules() == rules and len(drive.used) == used
    assert {finding.severity for finding in drive.gate.findings()} == severities
    assert drive.gate.certain is (used > 0)


def turned_off(number, begin, degrees):
    """East, north and up of a car that was carried away and turned before a fix."""
    if number < begin:
        return [0.0, 0.0, 0.0]
    ahead = SPEED * (number - begin) * np.array([np.cos(HEADING), np.sin(HEADING)])
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return [*(turn @ ahead - ahead + [30.0, -10.0]), 0.0]


def test_fixes_behind_a_cut_that_nobody_follows_are_an_error():
    drive = driven(20, 1.0, lambda i: turned_off(i, 13, 60.0))
    assert len(drive.refused) == 7
    found = {one.rule: one for one in drive.gate.findings()}
    assert found['fixes_elsewhere'].severity is Severity.ERROR
    assert 'the last 7 fixes' in found['fixes_elsewhere'].text
    # One that comes back to the map refutes them.
    drive.fix(20, 20.0, np.zeros(3))
    assert 'fixes_elsewhere' not in drive.rules()


@pytest.mark.parametrize('unmatched', [frozenset(), frozenset([245])])
def test_a_step_where_odometry_is_interrupted_may_be_a_cut(unmatched):
    drive = Drive()
    drive.unmatched = unmatched
    for i in range(40):
        drive.fix(i, float(i), np.array([0.0, 40.0 * (i > 24), 0.0]))
    (step,) = [one for one in drive.gate.findings() if one.rule == 'datum_step']
    assert step.severity is (Severity.ERROR if unmatched else Severity.WARNING)


def test_fixes_from_before_the_first_scan_are_held_against_no_odometry():
    """A LiDAR takes 20 s to start, and the car has driven off."""
    drive = Drive()
    drive.scans = 200
    for i in range(34):
        drive.fix(i, i, np.zeros(3))
    assert set(drive.used) == set(range(34)) and not drive.gone and not drive.rules()
    assert not drive.doubtful and off_datum(drive) < 0.1
    # A fix that no car has driven to is refused all the same.
    drive.fix(34, 34, np.array([30.0, 30.0, 0.0]))
    assert 34 in drive.refused


def test_fixes_before_the_first_scan_may_jump_no_further_than_a_car_drives():
    drive = Drive()
    drive.scans = 200
    for i in range(30):
        drive.fix(i, i, np.array([0.0, 100.0, 0.0]) if i < 3 else np.zeros(3))
    assert drive.rules() and drive.doubtful


def seen_by_halves(drive, shift, deviation):
    """Let every second match fail, and the others read a shift aside, and say how weakly."""
    for number in range(1, 60):
        stamp = START + number * NANOSECONDS // 10
        core = CoreMeasurement(stamp, 'left', CoreKind.LIDAR)
        nowhere, before = np.zeros((1, 3)), stamp - NANOSECONDS // 10
        if number % 2:
            scan = PreparedScan(core, nowhere, nowhere, None, None)
        else:
            motion = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, shift, 0.0]))
            covariance = np.diag([1e-6, 1e-6, 1e-6, 0.01, deviation**2, 0.01])
            scan = PreparedScan(core, nowhere, nowhere, before, motion, covariance=covariance)
        drive.gate.scan(scan)
        if number % 10 == 0:
            drive.scans = number + 1
            drive.fix(number // 10, number / 10, np.zeros(3))
    return drive


def test_a_weak_match_that_goes_on_errs_for_as_long_as_it_goes_on():
    """A LiDAR in a field reads 0.9 m aside from scan to scan of a car that stands."""
    drive = seen_by_halves(Drive(speed=0.0), 0.9, 0.55)
    assert set(drive.used) == set(range(1, 6)) and not drive.doubtful
    # Where it says that it is sure, fixes and odometry contradict each other.
    assert seen_by_halves(Drive(speed=0.0), 0.9, 0.05).doubtful


def test_a_heading_that_odometry_has_lost_condemns_no_fix():
    """A boat rolls and yaws, and every second half of a second no scan is matched."""
    drive = Drive(speed=3.0)
    for number in range(1, 301):
        stamp = START + number * NANOSECONDS // 10
        core = CoreMeasurement(stamp, 'left', CoreKind.LIDAR)
        nowhere, before = np.zeros((1, 3)), stamp - NANOSECONDS // 10
        if number % 10 < 5:
            # What it turns here it turns back while nothing is seen.
            motion = gtsam.Pose3(gtsam.Rot3.Yaw(0.15 if number % 10 == 4 else 0.0), [0.3, 0, 0])
            scan = PreparedScan(core, nowhere, nowhere, before, motion)
        else:
            scan = PreparedScan(core, nowhere, nowhere, None, None)
        drive.gate.scan(scan)
        if number % 10 == 0:
            drive.scans = number + 1
            drive.fix(number // 10, number / 10, np.zeros(3))
    assert len(drive.used) == 30 and not drive.refused and not drive.doubtful
