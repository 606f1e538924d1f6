"""Steps about a pivot: one step turns a whole drive, and Jacobians are those of what it does."""

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    constant_velocity_prior,
    gnss_factor,
)
from incremental_mapper.smoothing.batch import make_graph
from incremental_mapper.smoothing.linear_system import Layout
from incremental_mapper.smoothing.tangent import (
    Pivoted,
    linearised,
    move_pivot,
    retracted,
    to_base_rows,
    to_own_rows,
)
from incremental_mapper.variables import pose_key, velocity_key

KEYS = (pose_key(0), velocity_key(0), velocity_key(1), pose_key(1))
LAYOUT = Layout(KEYS)
seeds = st.integers(0, 10_000)


def anywhere(rng):
    values = gtsam.Values()
    for cluster in (0, 1):
        pose = gtsam.Pose3.Expmap(rng.normal(size=6)).compose(
            gtsam.Pose3(gtsam.Rot3(), rng.normal(size=3) * 30.0)
        )
        values.insert(pose_key(cluster), pose)
        values.insert(velocity_key(cluster), rng.normal(size=3) * 5.0)
    return values


def measured(rng):
    """Factors of both kinds of variables, their errors far from zero."""
    motion = gtsam.Pose3.Expmap(rng.normal(size=6) * 0.3)
    keys = pose_key(0), pose_key(1)
    made = [
        between_factor(FactorKind.ODOMETRY, keys, motion, np.eye(6), 'left', (0, 1)),
        constant_velocity_prior((velocity_key(0), velocity_key(1)), np.ones(3), 0.5, (0, 1)),
        gnss_factor(pose_key(0), np.ones(3), np.eye(3), np.array([0.5, 0.0, 1.0]), 0.0, 'gnss', 0),
    ]
    return make_graph(factor.factor for factor in made)


@settings(deadline=None, max_examples=20)
@given(seeds, st.floats(-1.0, 1.0))
def test_one_step_turns_all_of_a_drive_wherever_it_is(seed, turn):
    rng = np.random.default_rng(seed)
    values, pivot, centre = anywhere(rng), rng.normal(size=3) * 20.0, rng.normal(size=3) * 20.0
    up = np.array([0.0, 0.0, turn])
    step = np.zeros(LAYOUT.size)
    for _, place in LAYOUT.poses:
        step[place] = np.concatenate([up, np.cross(up, pivot - centre)])
    moved = retracted(Pivoted(values, pivot), LAYOUT, step)
    rotation = gtsam.Rot3.Yaw(turn)
    for cluster in (0, 1):
        before, after = (item.atPose3(pose_key(cluster)) for item in (values, moved))
        place = centre + rotation.rotate(before.translation() - centre)
        assert after.equals(gtsam.Pose3(rotation.compose(before.rotation()), place), 1e-9)
        velocity = rotation.rotate(values.atVector(velocity_key(cluster)))
        assert moved.atVector(velocity_key(cluster)) == pytest.approx(velocity, abs=1e-9)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_rows_are_how_errors_change_with_a_step(seed):
    rng = np.random.default_rng(seed)
    values, graph, pivot = anywhere(rng), measured(rng), rng.normal(size=3) * 20.0
    rows, rhs = linearised(LAYOUT, graph, Pivoted(values, pivot))
    step = rng.normal(size=LAYOUT.size) * 1e-6
    moved = retracted(Pivoted(values, pivot), LAYOUT, step)
    _, after = linearised(LAYOUT, graph, Pivoted(moved, pivot))
    assert after - rhs == pytest.approx(-rows @ step, abs=2e-8)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_same_motion_about_another_pivot(seed):
    rng = np.random.default_rng(seed)
    values, graph = anywhere(rng), measured(rng)
    first, second = rng.normal(size=(2, 3)) * 20.0
    rows, _ = linearised(LAYOUT, graph, Pivoted(values, first))
    move_pivot(rows, LAYOUT, second - first)
    expected, _ = linearised(LAYOUT, graph, Pivoted(values, second))
    assert rows == pytest.approx(expected, abs=1e-9)


@settings(deadline=None, max_examples=20)
@given(seeds)
def test_own_rows_are_the_steps_that_gtsam_takes_for_the_same_motion(seed):
    rng = np.random.default_rng(seed)
    values, pivot = anywhere(rng), rng.normal(size=3) * 20.0
    step = rng.normal(size=LAYOUT.size) * 1e-6
    moved = retracted(Pivoted(values, pivot), LAYOUT, step)
    rows = step[:, None].copy()
    to_own_rows(rows, LAYOUT, Pivoted(values, pivot), KEYS)
    found = values.localCoordinates(moved)
    for key, place in LAYOUT.places.items():
        assert rows[place, 0] == pytest.approx(found.at(key), abs=1e-10)
    here = Pivoted(values, pivot)
    for key, place in LAYOUT.poses:
        assert here.own_step(key, step[place]) == pytest.approx(
            here.own_steps(key) @ step[place], abs=1e-15
        )
    # Along the axes of base_link a velocity changes as the vehicle sees it.
    rows = step[:, None].copy()
    to_base_rows(rows, LAYOUT, Pivoted(values, pivot), KEYS)
    for velocity in LAYOUT.velocities:
        before, after = (
            item.atPose3(velocity.pose_key).rotation().unrotate(item.atVector(velocity.key))
            for item in (values, moved)
        )
        assert rows[velocity.place, 0] == pytest.approx(after - before, abs=1e-10)


def test_velocity_without_its_pose_just_gets_its_step():
    layout, values = Layout([velocity_key(7), pose_key(0)]), gtsam.Values()
    values.insert(velocity_key(7), np.array([1.0, 2.0, 3.0]))
    values.insert(pose_key(0), gtsam.Pose3())
    step = np.array([0.1, 0.0, -0.1, 0.0, 0.0, 0.7, 0.0, 0.0, 0.0])
    assert layout.velocities == ()
    moved = retracted(Pivoted(values, np.zeros(3)), layout, step)
    assert moved.atVector(velocity_key(7)) == pytest.approx([1.1, 2.0, 2.9])
