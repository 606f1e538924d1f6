"""Evidence on the place of the antenna, gathered fix by fix."""

import numpy as np

from incremental_mapper.frontend.antenna_watch import EACH, MOST, AntennaWatch
from incremental_mapper.frontend.fix_tracks import Entry
from incremental_mapper.frontend.odometry_track import Place
from incremental_mapper.measurements import NANOSECONDS, FixStatus, GnssFix

METRE = np.degrees(1.0 / 6_371_000.0)
ARM = np.array([0.5, 0.0, 1.7])


def drive(error, count, every=1.0):
    """A car in bends at a speed that varies, its antenna ``error`` (2,) from where it should be."""
    grid = np.arange(0.0, 2000.0, 0.01)
    headings = 0.9 * np.sin(grid / 15.0)
    east, north = np.cumsum(0.01 * np.cos(headings)), np.cumsum(0.01 * np.sin(headings))
    way = 0.0
    for number in range(count):
        way += every * (6.0 + 3.0 * np.sin(0.3 * number))
        heading = float(np.interp(way, grid, headings))
        base = np.interp(way, grid, east) + 1j * np.interp(way, grid, north)
        ahead = np.exp(1j * heading)
        stamp = round((1000.0 + number * every) * NANOSECONDS)
        true = base + ahead * (ARM[0] + 1j * ARM[1] + complex(*error))
        latitude = 36.4 + METRE * true.imag
        longitude = 129.0 + METRE * true.real / np.cos(np.radians(36.4))
        antenna = base + ahead * (ARM[0] + 1j * ARM[1])
        position = np.array([antenna.real, antenna.imag, 1.7])
        place = Place(stamp, position, heading, way, 0.0, 0.0, 0.0, 0.0)
        fix = GnssFix(stamp, 'gnss', latitude, longitude, 90.0, FixStatus.GBAS)
        yield Entry(fix, place, 0.02, 0.03)


def looked(entries):
    watch = AntennaWatch(ARM)
    found = []
    for entry in entries:
        watch.take(entry)
        found.append(watch.finding('gnss', last=False))
    return found, watch


def test_it_looks_every_so_many_fixes_and_at_the_end():
    found, watch = looked(drive((0.0, 2.0), EACH + 5))
    assert [number for number, one in enumerate(found) if one is not None] == [EACH - 1]
    assert '2.0 m left' in found[EACH - 1].text and found[EACH - 1].changes
    assert watch.finding('gnss', last=True) is not None
    assert watch.finding('gnss', last=True) is None  # there is no more than before


def test_what_turns_up_late_does_not_end_the_map():
    found, _ = looked(drive((0.0, 2.0), MOST + EACH))
    assert [one.changes for one in found if one is not None] == [True, True, False]


def test_an_antenna_in_its_place_is_left_alone():
    found, watch = looked(drive((0.0, 0.0), 100))
    assert not any(found) and watch.finding('gnss', last=True) is None


def test_fixes_of_a_standing_car_are_not_kept():
    found, watch = looked(drive((0.0, 2.0), 60, every=0.01))
    assert not any(found) and watch.finding('gnss', last=True) is None
