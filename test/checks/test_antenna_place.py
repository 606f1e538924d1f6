"""An antenna that is not where the settings put it, by how fixes swing in turns."""

from dataclasses import fields, replace

import numpy as np
import pytest

from incremental_mapper.checks.antenna_place import TurningTrack, antenna_finding
from incremental_mapper.checks.finding import Severity
from incremental_mapper.measurements import NANOSECONDS

ARM = np.array([-0.3, 0.0, 1.7])
SECONDS = 60.0


def track(error=(0.0, 0.0), late=0.0, turns=0.8, speed=4.0, noise=0.03, drift=0.0, rate=1.0):
    """Fixes of an antenna that is ``error`` ahead and left of where it should be.

    The car turns to and fro by ``turns`` radians, its speed varies by ``speed``; odometry reads
    ``drift`` too much, and wanders by a centimetre a metre.
    """
    rng = np.random.default_rng(1)
    grid = np.arange(-5.0, SECONDS + 5.0, 0.01)
    yaw = turns * np.sin(0.3 * grid)
    steps = 0.01 * (6.0 + speed * np.sin(0.5 * grid)) * np.exp(1j * yaw)
    base, arm = np.cumsum(steps), ARM[0] + 1j * ARM[1]
    at = np.arange(0.5, SECONDS - 0.5, 1.0 / rate)

    def there(values, when):
        return np.interp(when, grid, values.real) + 1j * np.interp(when, grid, values.imag)

    def antenna(when, place):
        return there(base, when) + place * there(np.exp(1j * yaw), when)

    enu = antenna(at - late, arm + complex(*error)) * np.exp(0.9j)
    enu = enu + rng.normal(scale=noise, size=(len(at), 2)) @ [1.0, 1j]
    wander = np.cumsum(rng.normal(scale=0.06 / np.sqrt(rate), size=(len(at), 2)) @ [1.0, 1j])
    local = (1.0 + drift) * antenna(at, arm) + wander
    return TurningTrack(
        np.round(at * NANOSECONDS).astype(np.int64),
        np.stack([enu.real, enu.imag], axis=1),
        np.stack([local.real, local.imag], axis=1),
        np.interp(at, grid, yaw) + 3.0,
        np.full(len(at), noise),
        np.zeros(len(at)),
    )


def turned(one, angle):
    """The same with odometry's frame turned."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    headings = one.headings - 3.0 + angle
    return replace(one, local=one.local @ turn.T, headings=headings)


@pytest.mark.parametrize('error', [(4.0, 0.0), (0.0, 2.0), (-2.0, -1.5), (1.2, 0.9)])
@pytest.mark.parametrize('rate', [1.0, 5.0])
def test_the_place_of_the_antenna_is_found(error, rate):
    found = antenna_finding('gnss', turned(track(error, rate=rate), 0.4), ARM, early=False)
    assert found is not None and found.rule == 'antenna_place'
    assert found.severity is Severity.WARNING and not found.changes
    place = found.settings['gnss']['T_base_sensor']
    assert place[:2] == pytest.approx(np.add(ARM[:2], error), abs=0.3)
    assert place[2:] == [1.7, 0.0, 0.0, 0.0, 1.0]
    assert f'gnss.T_base_sensor: {place}' in found.remedy


def test_what_is_known_to_half_a_metre_is_odometry_that_is_wrong():
    for error in ((4.0, 0.0), (0.0, 6.0), (30.0, 80.0)):
        one = track(error, noise=3.0, rate=1.0)
        assert antenna_finding('gnss', turned(one, 0.4), ARM, early=True) is None


@pytest.mark.parametrize('drift', [0.0, -0.05])
@pytest.mark.parametrize('late', [0.0, 0.4])
@pytest.mark.parametrize('noise', [0.03, 1.0])
def test_an_antenna_in_its_place_is_left_alone(drift, late, noise):
    for rate in (1.0, 5.0):
        one = track(drift=drift, late=late, noise=noise, rate=rate)
        assert antenna_finding('gnss', turned(one, 0.4), ARM, early=False) is None


def test_along_the_car_it_cannot_be_told_from_a_lag_at_one_speed():
    one = turned(track((4.0, 0.0), speed=0.0), 0.4)
    assert antenna_finding('gnss', one, ARM, early=False) is None


def test_across_the_car_it_can():
    found = antenna_finding('gnss', turned(track((4.0, 2.0), speed=0.0), 0.4), ARM, early=False)
    assert found is not None
    assert found.settings['gnss']['T_base_sensor'][:2] == pytest.approx([ARM[0], 2.0], abs=0.3)
    assert '2.0 m left' in found.text and 'ahead' not in found.text


def test_on_a_straight_road_nothing_is_said():
    assert (
        antenna_finding('gnss', turned(track((4.0, 2.0), turns=0.0), 0.4), ARM, early=False) is None
    )
    assert (
        antenna_finding('gnss', turned(track((4.0, 2.0), turns=0.02), 0.4), ARM, early=False)
        is None
    )


def test_a_few_wrong_fixes_do_not_matter():
    one = turned(track((0.0, 2.0)), 0.4)
    one.enu[[7, 20, 33]] += [9.0, -5.0]
    found = antenna_finding('gnss', one, ARM, early=False)
    assert found is not None
    assert found.settings['gnss']['T_base_sensor'][:2] == pytest.approx([ARM[0], 2.0], abs=0.3)
    one = turned(track(), 0.4)
    one.enu[[7, 20, 33]] += [9.0, -5.0]
    assert antenna_finding('gnss', one, ARM, early=False) is None


def town(seed):
    """Two bends of a street, in which houses spoil the fixes, and these say so."""
    rng = np.random.default_rng(seed)
    grid = np.arange(0.0, 45.0, 0.01)
    turned = np.clip((grid - 8.0) / 4.0, 0.0, 1.0) + np.clip((grid - 32.0) / 4.0, 0.0, 1.0)
    yaw = 0.5 * np.pi * turned
    base = np.cumsum(0.01 * (5.5 + np.sin(0.3 * grid)) * np.exp(1j * yaw))
    at = np.arange(100, 4400, 100)
    sigmas = np.full(len(at), 0.025)
    sigmas[8:14], sigmas[32:37] = 2.0, 0.3
    ahead = np.exp(1j * yaw[at])
    local = base[at] + (ARM[0] + 1j * ARM[1]) * ahead
    enu = local + sigmas * (rng.normal(size=(len(at), 2)) @ [1.0, 1j])
    local = local + np.cumsum(rng.normal(scale=0.015, size=(len(at), 2)) @ [1.0, 1j])
    both = (np.stack([place.real, place.imag], axis=1) for place in (enu, local))
    return TurningTrack(at * (NANOSECONDS // 100), *both, yaw[at], sigmas, np.zeros(len(at)))


@pytest.mark.parametrize('seed', [3, 10, 13, 19])
def test_poor_fixes_in_the_bends_do_not_move_the_antenna(seed):
    assert antenna_finding('gnss', town(seed), ARM, early=True) is None


def test_what_is_found_early_is_in_force():
    found = antenna_finding('gnss', turned(track((0.0, 2.0)), 0.4), ARM, early=True)
    assert found is not None and found.changes and 'in force' in found.remedy


def test_what_fixes_cannot_tell_anyway_is_no_matter():
    one = turned(track((0.0, 1.5)), 0.4)
    rough = replace(one, sigmas=np.full(len(one.stamps), 2.0))
    assert antenna_finding('gnss', one, ARM, early=False) is not None
    assert antenna_finding('gnss', rough, ARM, early=False) is None


def test_few_fixes_tell_nothing():
    one = track((4.0, 2.0))
    few = TurningTrack(*(getattr(one, field.name)[:9] for field in fields(one)))
    assert antenna_finding('gnss', few, ARM, early=False) is None


@pytest.mark.parametrize('error', [0.0, 2.0])
def test_where_the_scans_hold_odometry_weakly_it_says_nothing(error):
    """To the left of the car it slips, which looks like an antenna on the other side."""
    one = track((0.0, error))
    weak = slice(10, 30)
    aside = 3.0 * np.stack([-np.sin(one.headings - 3.0), np.cos(one.headings - 3.0)], axis=1)
    steps = np.diff(one.local, axis=0)
    steps[weak] += np.diff(aside, axis=0)[weak]
    local = np.vstack([one.local[:1], one.local[0] + np.cumsum(steps, axis=0)])
    slipping = turned(replace(one, local=local), 0.4)
    grown = np.zeros(len(steps))
    grown[weak] = 0.5
    known = replace(slipping, slipped=np.append(0.0, np.cumsum(grown)))
    deceived = antenna_finding('gnss', slipping, ARM, early=False)
    sound = antenna_finding('gnss', known, ARM, early=False)
    assert deceived is not None
    assert deceived.settings['gnss']['T_base_sensor'][1] != pytest.approx(error, abs=0.5)
    if error:
        assert sound is not None
        place = sound.settings['gnss']['T_base_sensor']
        assert place[:2] == pytest.approx([ARM[0], error], abs=0.3)
    else:
        assert sound is None
    everywhere = replace(slipping, slipped=np.arange(len(one.stamps), dtype=np.float64))
    assert antenna_finding('gnss', everywhere, ARM, early=False) is None
