"""Which sensors a solved graph does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from incremental_mapper.checks.finding import Severity
from incremental_mapper.checks.residuals import DOUBTFUL, DOUBTFUL_SPAN, Residuals, fit_findings

S = 1_000_000_000


def group(squared, kind='odometry', sensor='left', hz=10.0):
    squared = np.asarray(squared, dtype=float)
    stamps = (np.arange(len(squared)) * S / hz).astype(np.int64) + 100 * S
    size = np.sqrt(squared)
    return Residuals(kind, sensor, stamps, squared, 0.1 * size, 0.01 * size)


def test_noise_as_expected_is_no_finding():
    noise = np.random.default_rng(1).chisquare(6, 600) / 6
    assert fit_findings([group(noise)], 100 * S) == []


def test_single_bad_matches_are_the_solvers_to_settle():
    squared = np.full(600, 0.5)
    squared[::7] = 1e4
    assert fit_findings([group(squared)], 100 * S) == []


def test_a_bad_stretch_is_told_with_its_time():
    squared = np.full(600, 0.5)
    squared[300:400] = 50.0
    (found,) = fit_findings([group(squared)], 100 * S)
    assert (found.rule, found.severity) == ('odometry_misfit', Severity.WARNING)
    assert found.sensor == 'left'
    assert 'in 2 of 12 parts, from 30.0 s to 39.9 s' in found.text
    assert 'lidars.left.T_base_sensor' in found.remedy


@pytest.mark.parametrize(
    ('kind', 'word'), [('gnss', 'gnss.time_offset'), ('imu', 'imu.T_base_sensor')]
)
def test_what_never_fits_makes_the_map_wrong(kind, word):
    (found,) = fit_findings([group(np.full(20, 2 * DOUBTFUL_SPAN), kind, kind, 1.0)], 100 * S)
    assert found.severity is Severity.ERROR
    assert 'all along' in found.text and word in found.remedy


def test_few_factors_tell_nothing():
    assert fit_findings([group(np.full(4, 1e6))], 0) == []


def test_the_bound_is_that_of_a_stretch():
    assert fit_findings([group(np.full(50, 0.99 * DOUBTFUL))], 0) == []
    assert len(fit_findings([group(np.full(50, 1.01 * DOUBTFUL))], 0)) == 1


def test_fixes_that_are_off_by_little_are_not_told_of():
    fixes = group(np.full(20, 2 * DOUBTFUL), 'gnss', 'gnss', 1.0)
    assert len(fit_findings([fixes], 0)) == 1
    assert fit_findings([replace(fixes, metres=np.full(20, 0.2))], 0) == []
