"""The track of the fixes beside odometry's, which has holes."""

import numpy as np
import pytest

from incremental_mapper.config import GnssSettings
from incremental_mapper.frontend.fix_shape_watch import BLIND, ShapeWatch
from incremental_mapper.frontend.fix_tracks import Entry
from incremental_mapper.frontend.odometry_track import Place
from incremental_mapper.measurements import NANOSECONDS, FixStatus, GnssFix

METRE = np.degrees(1.0 / 6_371_000.0)
SIGMA = 0.02


def watch_of(blind, ahead):
    """A watch with a fix every 4 m of a bend; a tenth of the way north is lost every 6 fixes.

    Args:
        blind: Seconds without odometry each time.
        ahead: Seconds from the newest scan to a fix.
    """
    watch = ShapeWatch(GnssSettings())
    angles = np.linspace(0.0, 1.5, 80)
    enu = 4.0 * np.cumsum(np.stack([np.cos(angles), np.sin(angles)], axis=1), axis=0)
    for number, (east, north) in enumerate(enu.tolist()):
        stamp = number * NANOSECONDS
        latitude, longitude = 48.0 + METRE * north, METRE * east / np.cos(np.radians(48.0))
        fix = GnssFix(stamp, 'gnss', latitude, 11.0 + longitude, 0.0, FixStatus.GBAS)
        part = number // 6
        lost = 0.1 * (enu[6 * part, 1] - enu[0, 1])
        position = np.array([east, north - lost, 0.0])
        place = Place(stamp, position, 0.0, 4.0 * number, blind * part, ahead, 0.0, 0.0)
        watch.take(Entry(fix, place, SIGMA, SIGMA))
    return watch


def test_what_odometry_has_seen_of_it_all_tells_a_stretched_track():
    found = watch_of(0.0, 0.1).finding('gnss', last=True)
    assert found is not None and found.rule == 'track_stretched'


@pytest.mark.parametrize(('blind', 'ahead'), [(1.2 * BLIND, 0.1), (0.0, 1.2 * BLIND)])
def test_over_what_it_has_not_seen_no_track_is_stretched(blind, ahead):
    assert watch_of(blind, ahead).finding('gnss', last=True) is None
