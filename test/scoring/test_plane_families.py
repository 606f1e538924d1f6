"""Normals sorted into three orthogonal families."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.scoring.plane_families import (
    MAX_AXES,
    orthogonal_families,
    spread_positions,
)


@settings(deadline=None)
@given(st.integers(0, 10_000), st.tuples(*[st.integers(5, 60)] * 3))
def test_normals_of_three_orthogonal_walls_are_sorted_into_three_families(seed, counts):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    truth = np.repeat(np.arange(3), counts)
    normals = turn.T[truth] * rng.choice([-1, 1], size=(len(truth), 1))
    found = orthogonal_families(normals.T, 0.2)
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    for wall_number in range(3):
        labels = set(found.labels[truth == wall_number].tolist())
        assert len(labels) == 1
        assert -1 not in labels
    assert len(set(found.labels.tolist())) == 3


def test_slanted_normals_belong_to_no_family():
    slanted = np.ones((4, 3)) / np.sqrt(3)
    normals = np.vstack([np.repeat(np.eye(3), 20, axis=0), slanted])
    found = orthogonal_families(normals.T, 0.2)
    assert found.labels[60:].tolist() == [-1] * 4
    assert (found.labels[:60] >= 0).all()


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 150), st.floats(0.05, 1.2), st.integers(0, 10_000))
def test_axes_have_the_most_votes_that_any_have(count, angle, seed):
    normals = np.random.default_rng(seed).normal(size=(count, 3))
    normals[::3] = np.eye(3)[seed % 3] + 0.1 * normals[::3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found, limit = orthogonal_families(normals.T, angle), np.cos(angle)

    def alike(axes):
        return np.abs(axes @ normals.T) > limit

    trial = normals[spread_positions(count, MAX_AXES)]
    near = alike(trial)[alike(trial).sum(axis=1).argmax()]
    mean = np.linalg.eigh(normals[near].T @ normals[near])[1][:, -1]
    assert abs(mean @ found.axes[0]) == pytest.approx(1.0, abs=1e-9)
    across = trial - np.outer(trial @ mean, mean)
    across = across[np.linalg.norm(across, axis=1) > limit]
    if len(across):
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        votes = alike(across).sum(axis=1) + alike(np.cross(mean, across)).sum(axis=1)
        assert alike(found.axes[1:]).sum() == votes.max()
    assert found.axes @ found.axes.T == pytest.approx(np.eye(3), abs=1e-9)
    best = np.abs(found.axes @ normals.T)
    assert found.labels.tolist() == np.where(best.max(0) > limit, best.argmax(0), -1).tolist()


def test_no_normal_makes_no_label():
    assert len(orthogonal_families(np.zeros((3, 0)), 0.2).labels) == 0


@given(st.integers(0, 500), st.integers(1, 100))
def test_spread_positions_are_distinct_and_within_reach(count, wanted):
    positions = spread_positions(count, wanted)
    assert len(positions) == min(count, wanted) == len(set(positions.tolist()))
    assert all(0 <= p < count for p in positions)


@pytest.mark.parametrize(
    ('count', 'wanted', 'positions'),
    [
        (10, 2, [0, 9]),
        (10, 3, [0, 4, 9]),
        (10, 1, [0]),
        (10, 0, []),
        (3, 3, [0, 1, 2]),
        (2, 9, [0, 1]),
    ],
)
def test_few_positions_reach_from_the_first_to_the_last(count, wanted, positions):
    assert spread_positions(count, wanted).tolist() == positions
