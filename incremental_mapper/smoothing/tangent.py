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

from collections.abc import Collection

import gtsam
import numpy as np

from incremental_mapper.smoothing.linear_system import Array, Layout


class Pivoted:
    """Values of variables, and the pivot (3,) in the map that steps away from them are about.

    What turns such steps into GTSAM's is computed once for each variable: values that are there may
    not change, others may be inserted.
    """

    __slots__ = ('_from_pivot', '_own_steps', '_swings', 'pivot', 'values')

    def __init__(self, values: gtsam.Values, pivot: Array) -> None:
        self.values = values
        self.pivot = pivot
        self._from_pivot: dict[int, gtsam.Pose3] = {}
        self._own_steps: dict[int, Array] = {}
        self._swings: dict[int, Array] = {}

    def own_step(self, key: int, step: Array) -> Array:
        """GTSAM's step (6,) of a pose for one about the pivot."""
        own: Array = self._seen_from_pivot(key).Adjoint(step)
        return own

    def own_steps(self, key: int) -> Array:
        """The matrix (6, 6) that makes GTSAM's steps of a pose of those about the pivot."""
        matrix = self._own_steps.get(key)
        if matrix is None:
            matrix = self._own_steps[key] = self._seen_from_pivot(key).AdjointMap()
        return matrix

    def swing(self, key: int) -> Array:
        """The matrix (3, 3) that tells by what a turn of its pose changes a velocity, negated."""
        matrix = self._swings.get(key)
        if matrix is None:
            matrix = self._swings[key] = gtsam.Rot3.Hat(self.values.atVector(key))
        return matrix

    def _seen_from_pivot(self, key: int) -> gtsam.Pose3:
        """The pivot as a pose sees it, the map's axes at the pivot."""
        seen = self._from_pivot.get(key)
        if seen is None:
            pose = self.values.atPose3(key)
            about = gtsam.Pose3(pose.rotation(), pose.translation() - self.pivot)
            seen = self._from_pivot[key] = about.inverse()
        return seen


def retracted(here: Pivoted, layout: Layout, step: Array) -> gtsam.Values:
    """The variables of a layout after a step.

    Args:
        here: Values of these variables, and of no others.
        layout: Where each one's step stands.
        step: All steps (n,), see above.
    """
    own, values = step.copy(), here.values
    for key, place in layout.poses:
        own[place] = here.own_step(key, step[place])
    for velocity in layout.velocities:
        before = values.atVector(velocity.key)
        turned = gtsam.Rot3.Expmap(step[velocity.turn]).rotate(before)
        own[velocity.place] += turned - before
    return values.retract(layout.vector_values(own))


def linearised(
    layout: Layout, graph: gtsam.NonlinearFactorGraph, here: Pivoted
) -> tuple[Array, Array]:
    """Whitened factors (r, n) over steps as above, and their right-hand sides (r,)."""
    augmented = graph.linearize(here.values).augmentedJacobian()
    rows = np.zeros((len(augmented), layout.size))
    rows[:, layout.columns(graph.keyVector())] = augmented[:, :-1]
    from_own_columns(rows, layout, here)
    return rows, augmented[:, -1].copy()


def from_own_columns(rows: Array, layout: Layout, here: Pivoted) -> None:
    """Turn columns for GTSAM's steps into those for steps as above.

    Args:
        rows: Jacobian (m, n), changed in place.
        layout: Where each variable's columns are.
        here: Where it was linearised.
    """
    for key, place in layout.poses:
        rows[:, place] = rows[:, place] @ here.own_steps(key)
    for velocity in layout.velocities:
        rows[:, velocity.turn] -= rows[:, velocity.place] @ here.swing(velocity.key)


def to_own_rows(rows: Array, layout: Layout, here: Pivoted, keys: Collection[int]) -> None:
    """Turn steps as above into GTSAM's.

    Args:
        rows: Steps (n, k), k of them, changed in place.
        layout: Where each variable's rows are.
        here: Where they start.
        keys: The variables whose rows are turned.
    """
    for velocity in layout.velocities:
        if velocity.key in keys:
            rows[velocity.place] -= here.swing(velocity.key) @ rows[velocity.turn]
    for key, place in layout.poses:
        if key in keys:
            rows[place] = here.own_steps(key) @ rows[place]


def to_base_rows(rows: Array, layout: Layout, here: Pivoted, keys: Collection[int]) -> None:
    """As ``to_own_rows``, with the steps of velocities along the axes of their poses.

    A velocity as the vehicle itself sees it: the attitude has no part in its step.
    """
    for velocity in layout.velocities:
        if velocity.key not in keys:
            continue
        rotation = here.values.atPose3(velocity.pose_key).rotation()
        rows[velocity.place] = rotation.matrix().T @ rows[velocity.place]
    for key, place in layout.poses:
        if key in keys:
            rows[place] = here.own_steps(key) @ rows[place]


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
