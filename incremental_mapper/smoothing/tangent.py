"""Tangent steps of the variables that are solved for: about a pivot, along the axes of the map.

A step (ω, ρ) of a pose T moves it to Exp(ω, ρ) · T, where the map's origin is the pivot, and a
velocity v beside it by its own step ν to Exp(ω) · v + ν. So a drive that turns about the vertical
as a whole has one and the same step whatever the estimates are, and a prior that is linear in such
steps says of it what was measured, however often it is linearised. With GTSAM's own steps, along
the axes of the vehicle, the turn is another step after each window, and looks measured a little
better each time; and v + ν makes the vehicle faster by the square of the turn: where yaw was
hardly known, 5 degrees were the cheapest way to go 0.02 m/s faster.

A velocity whose pose is not among the variables just gets its step, and eliminated variables have
GTSAM's: they are only looked up.
"""

import gtsam
import numpy as np

from incremental_mapper.smoothing.linear_system import Array, Layout


def retracted(values: gtsam.Values, layout: Layout, step: Array, pivot: Array) -> gtsam.Values:
    """The variables of a layout after a step.

    Args:
        values: Values of these variables, and of no others.
        layout: Where each one's step stands.
        step: All steps (n,), see above.
        pivot: What they are about (3,), metres in the map.
    """
    own = step.copy()
    for key, place in layout.poses:
        own[place] = own_step(values.atPose3(key), step[place], pivot)
    for velocity in layout.velocities:
        before = values.atVector(velocity.key)
        turned = gtsam.Rot3.Expmap(step[velocity.turn]).rotate(before)
        own[velocity.place] += turned - before
    return values.retract(layout.vector_values(own))


def own_step(pose: gtsam.Pose3, step: Array, pivot: Array) -> Array:
    """GTSAM's step (6,) of a pose for one about a pivot."""
    own: Array = _from_pivot(pose, pivot).Adjoint(step)
    return own


def own_steps(pose: gtsam.Pose3, pivot: Array) -> Array:
    """The matrix (6, 6) that makes GTSAM's steps of a pose of those about a pivot."""
    matrix: Array = _from_pivot(pose, pivot).AdjointMap()
    return matrix


def _from_pivot(pose: gtsam.Pose3, pivot: Array) -> gtsam.Pose3:
    return gtsam.Pose3(pose.rotation(), pose.translation() - pivot).inverse()


def linearised(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, pivot: Array
) -> tuple[Array, Array]:
    """Whitened factors (r, n) over steps as above, and their right-hand sides (r,)."""
    augmented = graph.linearize(values).augmentedJacobian()
    rows = np.zeros((len(augmented), layout.size))
    rows[:, layout.columns(graph.keyVector())] = augmented[:, :-1]
    from_own_columns(rows, layout, values, pivot)
    return rows, augmented[:, -1].copy()


def from_own_columns(
    rows: Array,
    layout: Layout,
    values: gtsam.Values,
    pivot: Array,
    known: dict[int, Array] | None = None,
) -> None:
    """Turn columns for GTSAM's steps into those for steps as above.

    Args:
        rows: Jacobian (m, n), changed in place.
        layout: Where each variable's columns are.
        values: Where it was linearised.
        pivot: What the steps are about (3,), metres in the map.
        known: ``own_steps`` of some poses, to which those of the others are added.
    """
    known = {} if known is None else known
    for key, place in layout.poses:
        matrix = known.get(key)
        if matrix is None:
            matrix = known[key] = own_steps(values.atPose3(key), pivot)
        rows[:, place] = rows[:, place] @ matrix
    for velocity in layout.velocities:
        swing = gtsam.Rot3.Hat(values.atVector(velocity.key))
        rows[:, velocity.turn] -= rows[:, velocity.place] @ swing


def to_own_rows(rows: Array, layout: Layout, values: gtsam.Values, pivot: Array) -> None:
    """Turn steps as above into GTSAM's.

    Args:
        rows: Steps (n, k), k of them, changed in place.
        layout: Where each variable's rows are.
        values: Where they start.
        pivot: What they are about (3,), metres in the map.
    """
    for velocity in layout.velocities:
        swing = gtsam.Rot3.Hat(values.atVector(velocity.key))
        rows[velocity.place] -= swing @ rows[velocity.turn]
    for key, place in layout.poses:
        rows[place] = own_steps(values.atPose3(key), pivot) @ rows[place]


def to_base_rows(rows: Array, layout: Layout, values: gtsam.Values, pivot: Array) -> None:
    """As ``to_own_rows``, with the steps of velocities along the axes of their poses.

    A velocity as the vehicle itself sees it: the attitude has no part in its step.
    """
    for velocity in layout.velocities:
        rotation = values.atPose3(velocity.pose_key).rotation()
        rows[velocity.place] = rotation.matrix().T @ rows[velocity.place]
    for key, place in layout.poses:
        rows[place] = own_steps(values.atPose3(key), pivot) @ rows[place]


def move_pivot(rows: Array, layout: Layout, shift: Array) -> None:
    """Turn columns for steps about one pivot into those about another.

    Args:
        rows: Jacobian (m, n), changed in place.
        layout: Where each variable's columns are.
        shift: From the one to the other (3,), metres in the map.
    """
    swing = gtsam.Rot3.Hat(shift)
    for _, place in layout.poses:
        turn, move = place.start, place.start + 3
        rows[:, turn:move] += rows[:, move : place.stop] @ swing
