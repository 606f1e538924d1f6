"""Fixes without a vertical, and receivers that repeat themselves."""

import numpy as np
import pytest
from bag_files import FIX, MS, START, STORES, message
from rosbags.rosbag2 import StoragePlugin, Writer

from incremental_mapper.config import Config, GnssSettings
from incremental_mapper.datasets.message_conversion import fix_from_message
from incremental_mapper.datasets.open import open_source
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.frontend.gnss import checked_covariance
from incremental_mapper.measurements import NO_VERTICAL_SIGMA, make_fix

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


def test_a_whole_fix_is_not_remarked_and_a_bad_horizontal_is_unknown():
    assert fix().remarks == () and fix(covariance=None).remarks == ()
    bad = fix(covariance=np.diag([NAN, 0.09, 0.25]))
    assert bad.covariance is None and bad.remarks == ()


def test_without_altitude_and_covariance_the_default_is_horizontal():
    used = checked_covariance(fix(altitude=NAN, covariance=None), GnssSettings(default_sigma=1.5))
    np.testing.assert_allclose(np.sqrt(np.diag(used)), [1.5, 1.5, NO_VERTICAL_SIGMA])


def heights(altitudes) -> tuple[list[float], float]:
    front_end = FrontEnd(Config())
    ups = [
        float(front_end.prepare((fix(i + 1, altitude),))[0].enu[2])
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


def fixes_bag(path, places):
    """A bag of clouds' sake: fixes every 200 ms at the given latitudes."""
    store = STORES[2]
    cloud = 'sensor_msgs/msg/PointCloud2'
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            kind: writer.add_connection(name, kind, typestore=store)
            for name, kind in (('/points', cloud), ('/fix', FIX))
        }
        for i, latitude in enumerate(places):
            stamp = START + i * 200 * MS
            for kind, connection in connections.items():
                made = message(kind, stamp)
                if kind == FIX:
                    made.__dict__.update(latitude=latitude)
                writer.write(connection, stamp, store.serialize_cdr(made, kind))
    return path


def notes_of(path, places) -> list[str]:
    source = open_source(fixes_bag(path, places), {})
    list(source.measurements())
    return [note for note in source.info.notes if 'frozen_fix' in note]


def test_a_frozen_receiver_is_counted(tmp_path):
    moving = [36.5 + 1e-6 * i for i in range(10)]
    (note,) = notes_of(tmp_path / 'bag', [*moving, *[36.6] * 21, *moving, *[36.7] * 3])
    assert '20 fixes repeat' in note and 'up to 4.0 s' in note


def test_a_receiver_that_rounds_is_not_frozen(tmp_path):
    assert notes_of(tmp_path / 'bag', [36.5 + 1e-6 * (i // 4) for i in range(40)]) == []
