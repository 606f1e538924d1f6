"""What a map as a whole lacks."""

from dataclasses import replace

import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.outcome import Outcome, empty_findings, outcome_findings

SOUND = Outcome(
    clusters=100,
    bridges=0,
    windows=52,
    failed=0,
    carried=0,
    scans={'left': 50},
    matched={'left': 49},
    fixes=5,
    georeferenced=True,
    farthest=40.0,
)


def rules(outcome):
    return {finding.rule: finding for finding in outcome_findings(outcome)}


def test_a_sound_map_lacks_nothing():
    assert rules(SOUND) == {}


@pytest.mark.parametrize(('count', 'severity'), [(20, Severity.WARNING), (90, Severity.ERROR)])
def test_bridges_that_hold_the_graph(count, severity):
    found = rules(replace(SOUND, bridges=count))['held_by_bridges']
    assert found.severity is severity
    assert f'{count} of 100 poses' in found.text


def test_a_bridge_over_a_hole_is_no_matter():
    assert rules(replace(SOUND, bridges=1)) == {}


def test_failed_windows_name_the_files_of_their_inputs():
    found = rules(replace(SOUND, failed=2, records=('failed_window_5.npz',)))['windows_failed']
    assert found.severity is Severity.WARNING
    assert '2 of 52' in found.text and 'failed_window_5.npz' in found.text
    assert rules(replace(SOUND, failed=40))['windows_failed'].severity is Severity.ERROR


def test_windows_that_wait():
    assert set(rules(replace(SOUND, carried=20))) == {'windows_carried'}


def test_fixes_that_do_not_agree_with_the_motion():
    lost = replace(SOUND, georeferenced=False)
    assert set(rules(lost)) == {'not_georeferenced'}
    # A car that stands, or that has hardly any fixes, cannot know where north is.
    assert rules(replace(lost, farthest=3.0)) == {}
    assert rules(replace(lost, fixes=2)) == {}


def test_scans_that_are_not_matched_are_told_with_their_reasons():
    poor = replace(SOUND, matched={'left': 10}, reasons={'left': '39 match rejected'})
    found = rules(poor)['scans_unmatched']
    assert found.sensor == 'left'
    assert '80%' in found.text and '39 match rejected' in found.text


@pytest.mark.parametrize(('points', 'severity'), [(0, Severity.ERROR), (500, Severity.WARNING)])
def test_a_map_without_points(points, severity):
    (found,) = empty_findings(points, 50, 5.0)
    assert (found.rule, found.severity) == ('map_empty', severity)


def test_a_map_of_a_moment_or_without_scans_is_not_called_empty():
    assert empty_findings(200, 2, 0.1) == []
    assert empty_findings(0, 0, 60.0) == []
    assert empty_findings(20_000, 50, 5.0) == []


def test_a_map_that_hangs_on_the_imu_alone_is_an_error():
    alone = replace(
        SOUND,
        scans={'left': 3, 'right': 3},
        matched={},
        fixes=0,
        georeferenced=False,
        windows=7,
        reasons={'left': '2 no certain match over a gap'},
    )
    found = rules(alone)['held_by_imu_alone']
    assert found.severity is Severity.ERROR
    assert '0 of 4' in found.text and 'no certain match' in found.text
    assert 'held_by_imu_alone' not in rules(replace(alone, matched={'left': 2, 'right': 2}))
    assert 'held_by_imu_alone' not in rules(replace(alone, fixes=5, georeferenced=True))
    # Without an IMU it is bridges that hold it, which is said.
    assert 'held_by_imu_alone' not in rules(replace(alone, bridges=90))
