"""The compiled least-squares step against LAPACK's."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.smoothing.linear_system import best_step

HELD = 1e-3


def problem(seed, known, new, count):
    """Prior, regularising prior and factors of a few columns each, in units that differ by far."""
    rng = np.random.default_rng(seed)
    size = known + new
    units = 10.0 ** rng.uniform(-3, 3, size=size)
    root = rng.normal(size=(known + 2, known)) / units[:known]
    rows = np.zeros((count, size))
    for row in rows:
        touched = rng.choice(size, size=min(4, size), replace=False)
        row[touched] = rng.normal(size=len(touched)) / units[touched]
    prior = root, rng.normal(size=len(root)), root.T @ root
    return prior, (HELD, rng.normal(size=new)), (rows, rng.normal(size=count))


def stacked(prior, regularising, factors):
    """All rows and right-hand sides one above the other."""
    known, new = prior[0].shape[1], len(regularising[1])
    held = np.zeros((new, known + new))
    held[np.arange(new), known + np.arange(new)] = regularising[0]
    top = np.hstack([prior[0], np.zeros((len(prior[0]), new))])
    rhs = np.concatenate([prior[1], regularising[1], factors[1]])
    return np.vstack([top, held, factors[0]]), rhs


@settings(deadline=None, max_examples=100)
@given(
    st.integers(0, 10_000),
    st.integers(0, 12),
    st.integers(0, 15),
    st.integers(0, 40),
)
def test_step_is_the_least_squares_solution(seed, known, new, count):
    if known + new == 0:
        return
    given = problem(seed, known, new, count)
    matrix, rhs = stacked(*given)
    # Columns of very different units: LAPACK gets them scaled.
    scale = 1.0 / np.linalg.norm(matrix, axis=0)
    expected = scale * np.linalg.lstsq(matrix * scale, rhs, rcond=None)[0]
    step, *left = best_step(*given)
    # How far a step may be off follows from the condition of the scaled rows.
    condition = np.linalg.cond(matrix * scale)
    assert step / scale == pytest.approx(expected / scale, rel=1e-8, abs=1e-13 * condition**2)
    assert np.concatenate(left) == pytest.approx(rhs - matrix @ step, rel=1e-9, abs=1e-9)


def test_undetermined_variable_stays_where_the_regularising_prior_has_it():
    prior = np.eye(2), np.zeros(2), np.eye(2)
    rows = np.array([[1.0, 0.0, 0.0]])
    step, *_ = best_step(prior, (HELD, np.zeros(1)), (rows, np.ones(1)))
    assert step == pytest.approx([0.5, 0.0, 0.0])


@pytest.mark.parametrize('bad', [np.nan, np.inf])
@pytest.mark.parametrize('place', ['prior', 'rows', 'rhs'])
def test_what_is_not_finite_has_no_step(bad, place):
    prior, regularising, (rows, rhs) = problem(3, 3, 4, 9)
    if place == 'prior':
        prior[2][0, 0] = bad
    else:
        (rows if place == 'rows' else rhs).flat[0] = bad
    rows[0, 0] = bad if place == 'rows' else 1.0
    assert best_step(prior, regularising, (rows, rhs)) is None


def test_prior_that_says_nothing_of_a_variable_leaves_no_step():
    prior = np.zeros((1, 1)), np.zeros(1), np.zeros((1, 1))
    assert best_step(prior, (HELD, np.zeros(0)), (np.zeros((0, 1)), np.zeros(0))) is None


@pytest.mark.parametrize('seed', range(8))
def test_second_solve_makes_good_what_the_normal_equations_lose(seed):
    # Rows whose condition is a million: their normal equations have that squared.
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.normal(size=(30, 6)))
    right, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    rows = (left * np.logspace(0, -6, 6)) @ right.T
    wanted = rng.normal(size=6)
    prior = np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0))
    step, *_ = best_step(prior, (1e-12, np.zeros(6)), (rows, rows @ wanted))
    assert np.abs(step - wanted).max() < 1e-7
    once = np.linalg.solve(rows.T @ rows, rows.T @ (rows @ wanted))
    assert np.abs(once - wanted).max() > 1e-6
