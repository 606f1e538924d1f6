"""Fixes that are drawn away from the map little by little are believed less, and no others."""

from dataclasses import replace

import gtsam
import numpy as np
import pymap3d
import pytest
from test_georeferencing import ARM, DATUM, EPOCH, SECOND, drive, mapped, truth

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.fixes import Drawn, drawn_away
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.mapping.fix_pulls import FixPulls
from incremental_mapper.measurements import GnssFix

SIGMA = 0.05
COVARIANCE = np.eye(3) * SIGMA**2


def judged(offs, noise=0.1, grows=0.03):
    """What is added to the deviation of fixes of 1 Hz, where a doubted one leaves the map alone."""
    pulls, given, known = FixPulls(np.zeros(3)), [], noise
    for number, off in enumerate(offs):
        apart = np.asarray(off, dtype=float)
        given.append(pulls.doubt(EPOCH + number * SECOND, apart, known, COVARIANCE))
        known = known + grows if given[-1] else noise
    return given, pulls.told


def pulled(seconds, begin, length, metres):
    share = (seconds - begin) / length
    return metres * np.sin(np.pi * share) if 0.0 < share < 1.0 else 0.0


def test_a_pull_that_comes_and_goes_is_doubted_to_its_end():
    east = [pulled(second, 5.0, 10.0, 4.0) for second in range(20)]
    given, told = judged([(off, 0.0) for off in east])
    for off, doubt in zip(east, given, strict=True):
        assert doubt >= off if off > 0.3 else doubt == 0.0
    assert min(given[7:14]) > 6.0  # three times as far as they are off
    assert (told.looked_at, told.first) == (20, EPOCH + 6 * SECOND)
    assert told.most == pytest.approx(4.0) and told.count >= 7
    (finding,) = drawn_away('gnss', told)
    assert (finding.rule, finding.severity) == ('gnss_drift', Severity.MENDED)


def test_fixes_that_stay_apart_are_believed_after_ten_seconds():
    given, _ = judged([(3.0 * (second > 4), 0.0) for second in range(40)], grows=0.0)
    assert all(given[5:15]) and not any(given[:5]) and not any(given[17:])


def test_a_reference_that_wanders_on_is_never_believed_again():
    given, told = judged([(0.2 * max(second - 4, 0), 0.0) for second in range(60)], grows=0.0)
    assert all(given[8:])
    assert [one.severity for one in drawn_away('gnss', told)] == [Severity.ERROR]


def test_most_fixes_metres_off_are_an_error_however_they_came_to_be_believed_less():
    """One by one, with believed ones between, they made no row and were not told of."""
    told = Drawn()
    for number in range(12):
        told.look(20.0 if number % 4 else 0.0)
    (finding,) = drawn_away('gnss', told)
    assert finding.severity is Severity.ERROR and '9 of 12' in finding.text
    assert '20.0 m' in finding.text and 'the first' not in finding.text


def test_weak_matches_may_lean_as_far_as_the_best_lidar_may_be_off():
    """LiDARs that saw 90 degrees ahead: sound fixes were 5.7 m from the map."""
    pulls, nowhere = FixPulls(np.zeros(3)), np.zeros((1, 3))
    weak = np.diag([1e-6, 1e-6, 1e-6, 1e-4, 0.3**2, 1e-4])
    for number in range(1, 6):
        stamp = EPOCH + number * SECOND // 10
        for sensor, covariance in (('left', weak), ('right', 4.0 * weak), ('third', None)):
            core = CoreMeasurement(stamp, sensor, CoreKind.LIDAR)
            before, motion = stamp - SECOND // 10, gtsam.Pose3()
            scan = PreparedScan(core, nowhere, nowhere, before, motion, covariance=covariance)
            pulls._lean(scan)
    assert pulls._leaning == pytest.approx({'left': 1.5, 'right': 3.0})


def test_fixes_that_never_come_back_are_an_error_at_the_end_alone():
    """A map that has left its fixes looks as if these had left it."""
    _, told = judged([(0.8 * max(second - 14, 0), 0.0) for second in range(21)], grows=0.0)
    (driving,), (ended,) = drawn_away('gnss', told), drawn_away('gnss', told, ended=True)
    assert (driving.severity, ended.severity) == (Severity.MENDED, Severity.ERROR)
    assert 'the last of all is still 4.8 m off' in ended.text
    _, back = judged([(pulled(second, 5.0, 10.0, 4.0), 0.0) for second in range(20)])
    assert [one.severity for one in drawn_away('gnss', back, ended=True)] == [Severity.MENDED]


def test_single_fixes_and_small_ones_are_not_told():
    _, told = judged([(2.0 * (second in (8, 20, 24)), 0.0) for second in range(30)])
    assert told.count == 0 and drawn_away('gnss', told) == () == drawn_away('gnss', Drawn())


@pytest.mark.parametrize('sigma', [0.05, 0.5, 2.5])
def test_a_receiver_that_errs_by_its_noise_is_believed(sigma):
    pulls, random = FixPulls(np.zeros(3)), np.random.default_rng(5)
    covariance, known = np.eye(3) * sigma**2, float(np.hypot(sigma, 0.05))
    doubts = [
        pulls.doubt(EPOCH + number * SECOND, random.normal(0.0, sigma, 2), known, covariance)
        for number in range(2000)
    ]
    weights = sigma**2 / (sigma**2 + np.square(doubts))
    assert weights.mean() > 0.95
    assert drawn_away('gnss', pulls.told) == ()


@pytest.mark.parametrize('grows', [0.5, 5.0])
def test_a_map_that_was_turned_wrongly_at_first_does_not_leave_its_fixes(grows):
    """All are off, more and more, and no three in a row had agreed."""
    given, told = judged([(grows * second, 0.0) for second in range(3, 40)])
    assert not any(given) and told.count == 0


def test_a_map_that_knows_little_of_its_place_believes_the_fix():
    given, told = judged([(4.0, 3.0)], noise=4.0)
    assert given == [0.0] and told.count == 0


def test_a_receiver_that_says_that_it_errs_by_metres_is_no_error():
    rng = np.random.default_rng(7)
    _, told = judged(rng.normal(scale=3.0, size=(60, 2)), noise=3.0)
    assert told.astray < 0.5 * told.looked_at


def test_a_map_is_not_bent_by_fixes_that_are_drawn_aside():
    heading = 1.2

    def aside(item):
        if not isinstance(item, GnssFix):
            return item
        seconds = (item.stamp - EPOCH) / SECOND
        antenna = truth(seconds, heading).transformFrom(ARM)
        antenna = antenna + [pulled(seconds, 3.0, 4.5, 2.5), 0.0, 0.0]
        latitude, longitude, altitude = map(float, pymap3d.enu2geodetic(*antenna, *DATUM))
        return replace(item, latitude=latitude, longitude=longitude, altitude=altitude)

    result = mapped(heading, measurements=[aside(item) for item in drive(heading, seconds=9.0)])
    moments = (result.trajectory.stamps - EPOCH) / SECOND
    true = np.array([truth(moment, heading).translation() for moment in moments])
    off = (result.trajectory.positions - true)[:, :2]
    assert np.linalg.norm(off - off[0], axis=1).max() < 0.1  # 1.2 m where all are believed
    assert 'gnss_drift' in {finding.rule for finding in result.findings}
