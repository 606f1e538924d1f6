"""Fixes without a vertical, and receivers that repeat themselves."""

import numpy as np
import pytest
from bag_files import FIX, START, message

from incremental_mapper.checks.fix_covariance import checked_covariance
from incremental_mapper.config import Config, GnssSettings
from incremental_mapper.datasets.message_conversion import fix_from_message
from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.measurements import NANOSECONDS, NO_VERTICAL_SIGMA, make_fix

NAN = float('nan')
KNOWN = np.diag([0.04, 0.09, 0.25])
FLAT = np.diag([0.04, 0.09, NAN])


def fix(stamp=1, altitude=50.0, covariance=KNOWN, latitude=36.5):
    return make_fix(stamp, 'gnss', latitude, 127.25, altitude, 0, covariance)


@pytest.mark.parametrize(
    ('altitude', 'covariance', 'word'),
    [
        (NAN, FLAT, 'no_altitude'),
        (NAN, KNOWN, 'no_altitude'),
        (float('inf'), KNOWN, 'no_altitude'),
        (-1e300, KNOWN, 'no_altitude'),
        (1.1e5, KNOWN, 'no_altitude'),
        (50.0, FLAT, 'no_vertical_variance'),
        (50.0, np.diag([0.04, 0.09, 0.0]), 'no_vertical_variance'),
        (50.0, np.diag([0.04, 0.09, -1.0]), 'no_vertical_variance'),
    ],
)
def test_what_is_wrong_with_the_vertical_costs_the_vertical_only(altitude, covariance, word):
    made = fix(altitude=altitude, covariance=covariance)
    used = checked_covariance(made, GnssSettings(min_sigma=0.01))
    np.testing.assert_allclose(used, np.diag([0.04, 0.09, NO_VERTICAL_SIGMA**2]), rtol=1e-9)
    assert [remark.reason for remark in made.remarks] == [word]
    assert 'horizontal' in made.remarks[0].text


def test_a_bad_horizontal_is_told_beside_an_unknown_height():
    made = fix(altitude=NAN, covariance=np.diag([NAN, 0.09, NAN]))
    assert [remark.reason for remark in made.remarks] == ['no_altitude', 'no_variance']


def test_a_whole_fix_is_not_remarked_and_a_bad_horizontal_is_unknown():
    assert fix().remarks == () and fix(covariance=None).remarks == ()
    bad = fix(covariance=np.diag([NAN, 0.09, 0.25]))
    assert bad.covariance is None
    assert [remark.reason for remark in bad.remarks] == ['no_variance']


def test_variances_of_zero_that_are_said_to_be_known_are_not():
    zero = fix(covariance=np.zeros((3, 3)))
    assert zero.covariance is None
    assert [remark.reason for remark in zero.remarks] == ['no_variance']
    assert 'fixes.default_sigma' in zero.remarks[0].text


def test_without_altitude_and_covariance_the_default_is_horizontal():
    used = checked_covariance(fix(altitude=NAN, covariance=None), GnssSettings(default_sigma=1.5))
    np.testing.assert_allclose(np.sqrt(np.diag(used)), [1.5, 1.5, NO_VERTICAL_SIGMA])


def heights(altitudes) -> tuple[list[float], float]:
    front_end = FrontEnd(Config())
    ups = [
        float(front_end.prepare((fix((i + 1) * NANOSECONDS, altitude),))[0].enu[2])
        for i, altitude in enumerate(altitudes)
    ]
    assert front_end.datum is not None
    return ups, front_end.datum.altitude


@pytest.mark.parametrize(
    ('altitudes', 'ups', 'datum'),
    [
        ([NAN, NAN], [0.0, 0.0], 0.0),
        ([NAN, 50.0, NAN, 53.0, NAN], [0.0, 0.0, 0.0, 3.0, 3.0], 50.0),
        ([50.0, NAN, 52.0, NAN], [0.0, 0.0, 2.0, 2.0], 50.0),
    ],
)
def test_the_datum_never_gets_a_height_that_is_none(altitudes, ups, datum):
    found, height = heights(altitudes)
    assert height == datum
    np.testing.assert_allclose(found, ups, atol=1e-6)


def test_a_message_without_altitude_is_a_fix():
    raw = message(FIX, START)
    raw.__dict__.update(altitude=NAN)
    assert np.isnan(fix_from_message(raw).altitude)


def test_latitude_and_longitude_that_are_swapped_for_certain_are_swapped_back():
    swapped = make_fix(1, 'gnss', 127.3, 36.5, 50.0, 2, None)
    assert (swapped.latitude, swapped.longitude) == (36.5, 127.3)
    assert [remark.reason for remark in swapped.remarks] == ['swapped_fix']
    for latitude, longitude in ((127.3, 0.0), (127.3, 128.0), (181.0, 36.5)):
        with pytest.raises(MeasurementError):
            make_fix(1, 'gnss', latitude, longitude, 50.0, 2, None)
