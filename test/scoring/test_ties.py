"""Ties: a lead counts where it is more than chance, over planes and not over points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.scoring.ties import agrees, planes_of, ties

RNG = np.random.default_rng(5)


def judged(differences, planes, confidence=0.95, level=0.01):
    """Whether a candidate ties whose points are worse than the best's by ``differences``."""
    best = np.full(len(planes), level)
    weights = np.full(len(planes), 1.0 / len(planes))
    return ties(np.array([best, best + differences]), 0, weights, planes, confidence).tolist()


def test_the_best_ties_with_itself_and_with_what_scores_the_same():
    assert judged(np.zeros(40), np.arange(40) % 8) == [True, True]


def test_what_is_worse_in_every_plane_does_not_tie():
    planes = np.arange(40) % 8
    assert judged(1e-4 + 1e-6 * RNG.normal(size=40), planes) == [True, False]


def test_noise_around_a_small_lead_ties_and_more_confidence_ties_more():
    planes = np.arange(400) % 20
    noise = RNG.normal(scale=1e-3, size=400)
    noise -= noise.mean()
    assert judged(noise + 2e-5, planes) == [True, True]
    lead = noise + 1.2e-4
    assert judged(lead, planes, 0.5) == [True, False]
    assert judged(lead, planes, 0.9999) == [True, True]


def test_points_of_one_plane_are_one_witness():
    """One wall with a thousand points says no more than that wall."""
    planes = np.concatenate([np.zeros(1000, dtype=int), [1, 2, 3, 4, 5]])
    one_wall = np.concatenate([np.full(1000, 1e-4), np.full(5, -1e-3)])
    assert judged(one_wall, planes) == [True, True]
    assert judged(one_wall, np.arange(len(planes))) == [True, False]


@pytest.mark.parametrize('count', [1, 2])
def test_with_hardly_a_plane_the_lower_score_stands(count):
    planes = np.repeat(np.arange(count), 30)
    assert judged(np.full(len(planes), 1e-9), planes) == [True, False]


def test_a_candidate_without_a_map_never_ties():
    assert judged(np.full(40, np.nan), np.arange(40) % 8) == [True, False]


@given(st.integers(0, 10_000), st.floats(0.5, 0.99))
def test_ties_do_not_depend_on_the_unit(seed, confidence):
    rng = np.random.default_rng(seed)
    planes = rng.integers(0, 9, 60)
    planes = np.unique(planes, return_inverse=True)[1]
    values = rng.exponential(0.01, size=(5, 60))
    weights = np.full(60, 1 / 60)
    best = int((values @ weights).argmin())
    found = ties(values, best, weights, planes, confidence)
    assert found[best]
    assert (ties(values * 1e4, best, weights, planes, confidence) == found).all()


def test_false_alarms_of_the_test_are_as_many_as_it_says():
    """Two candidates that are equally good are told apart in one case of twenty."""
    planes = np.arange(120) % 12
    weights = np.full(120, 1 / 120)
    wrong = 0
    for _ in range(2000):
        shared = np.repeat(RNG.normal(scale=1e-3, size=12)[None], 10, axis=0).ravel()
        values = np.array([np.zeros(120), shared + RNG.normal(scale=1e-3, size=120)])
        wrong += not ties(values, 0, weights, planes, 0.95)[1]
    assert 0.03 < wrong / 2000 < 0.07


def test_planes_are_families_in_slices():
    axes = np.eye(3)
    points = np.array([[0.2, 5.0, 0], [0.4, 9.0, 0], [7.0, 5.0, 0], [0.2, 5.0, 0]])
    planes = planes_of(points, np.array([0, 0, 0, 1]), axes, 1.5)
    assert planes[0] == planes[1]
    assert len({planes[0], planes[2], planes[3]}) == 3
    assert sorted(set(planes.tolist())) == [0, 1, 2]


def test_a_smaller_graph_may_contradict_its_factors_by_what_chance_allows():
    # 95 % of a chi-squared variable of six degrees of freedom are below 12.6.
    assert agrees(20.0 + 12.0, 26, 20.0, 20, 0.95)
    assert not agrees(20.0 + 13.0, 26, 20.0, 20, 0.95)
    # Where the noise is twice what is said, so may the difference be.
    assert agrees(40.0 + 24.0, 26, 40.0, 20, 0.95)
    assert agrees(20.0, 20, 20.0, 20, 0.95)
