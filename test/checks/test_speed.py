"""Maps that move faster than vehicles."""

import numpy as np

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.speed import speed_findings

STAMPS = np.arange(100, dtype=np.int64) * 10**8


def straight(speed):
    return np.outer(np.arange(100) * 0.1 * speed, (1.0, 0.0, 0.0))


def test_a_train_is_possible():
    assert speed_findings(STAMPS, straight(90.0)) == []


def test_a_map_that_flies_is_not_to_be_trusted():
    places = straight(10.0)
    places[60:, 0] += 150.0
    (found,) = speed_findings(STAMPS, places)
    assert found.rule == 'impossible_speed' and found.severity is Severity.ERROR
    assert '310 m/s' in found.text


def test_a_step_of_decimetres_between_poses_of_one_moment_is_noise():
    places = straight(10.0)
    places[::2, 1] += 0.3
    stamps = STAMPS.copy()
    stamps[1::2] = stamps[::2] + 10**6
    assert speed_findings(stamps, places) == []


def test_short_maps_tell_nothing():
    assert speed_findings(STAMPS[:1], straight(10.0)[:1]) == []
    assert speed_findings(STAMPS[:0], straight(10.0)[:0]) == []
