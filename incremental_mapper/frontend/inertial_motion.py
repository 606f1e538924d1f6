"""How base_link moves around a sweep by the IMU: rotation, and translation from a velocity.

Rates and forces are integrated once, free of velocity and gravity; these are laid over them where
they are known, so that a better velocity costs no second integration.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.measurements import NANOSECONDS

Array = NDArray[np.float64]

BRIEF = 0.05
"""Seconds over which a force is felt, and is no noise of a sample."""
SMALL = 0.1
"""rad^2 below which three terms of a series tell sine and cosine to 1e-9."""


@dataclass(frozen=True, slots=True, eq=False)
class InertialMotion:
    """Motion of base_link around one moment; between its nodes it is steady.

    Attributes:
        moment: Seconds after the sweep's stamp.
        seconds: Nodes (K,), seconds after the sweep's stamp, in order.
        nodes: base_link at each node (K, 6), seen from base_link at the moment: rotation vectors,
            then positions, metres.
    """

    moment: float
    seconds: Array
    nodes: Array

    def between(self, start: float, end: float) -> gtsam.Pose3:
        """T_start_end, both in seconds after the sweep's stamp."""
        return self._pose(start).inverse().compose(self._pose(end))

    def moved(self, rows: Array, times: Array, moment: float) -> Array:
        """Points (3, N) seen at their times, as base_link would have seen them at a moment."""
        there = np.eye(4)
        if moment != self.moment:
            there = self.between(moment, self.moment).matrix()
        return _moved(np.ascontiguousarray(rows), times, self.seconds, self.nodes, there)

    def _pose(self, seconds: float) -> gtsam.Pose3:
        low = min(max(int(self.seconds.searchsorted(seconds)) - 1, 0), len(self.seconds) - 2)
        start, end = self.seconds[low : low + 2].tolist()
        share = min(max((seconds - start) / (end - start), 0.0), 1.0)
        node = self.nodes[low] + share * (self.nodes[low + 1] - self.nodes[low])
        return gtsam.Pose3(gtsam.Rot3.Expmap(node[:3]), node[3:])


@kernel
def _rodrigues(square: float) -> tuple[float, float]:
    """sin(a)/a and (1 - cos(a))/a^2 for the square of an angle, rad^2."""
    if square < SMALL:  # quicker, and as exact
        once = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        twice = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
    else:
        angle = np.sqrt(square)
        once, twice = np.sin(angle) / angle, (1.0 - np.cos(angle)) / square
    return once, twice


@kernel
def _moved(rows: Array, times: Array, seconds: Array, nodes: Array, there: Array) -> Array:
    """Points (3, N) by the poses between the nodes (K, 6) at their times, then by ``there`` (4, 4).

    Each point has a turn of its own, by Rodrigues' formula: p + sin(a)/a (w x p) +
    (1 - cos(a))/a^2 (w x (w x p)).
    """
    moved = np.empty_like(rows)
    last = len(seconds) - 2
    low = 0
    for i in range(rows.shape[1]):
        # Points come nearly in the order in which they were fired.
        while low < last and times[i] > seconds[low + 1]:
            low += 1
        while low > 0 and times[i] <= seconds[low]:
            low -= 1
        share = (times[i] - seconds[low]) / (seconds[low + 1] - seconds[low])
        wx = nodes[low, 0] + share * (nodes[low + 1, 0] - nodes[low, 0])
        wy = nodes[low, 1] + share * (nodes[low + 1, 1] - nodes[low, 1])
        wz = nodes[low, 2] + share * (nodes[low + 1, 2] - nodes[low, 2])
        once, twice = _rodrigues(wx * wx + wy * wy + wz * wz)
        x, y, z = rows[0, i], rows[1, i], rows[2, i]
        cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        x += once * cx + twice * (wy * cz - wz * cy)
        y += once * cy + twice * (wz * cx - wx * cz)
        z += once * cz + twice * (wx * cy - wy * cx)
        x += nodes[low, 3] + share * (nodes[low + 1, 3] - nodes[low, 3])
        y += nodes[low, 4] + share * (nodes[low + 1, 4] - nodes[low, 4])
        z += nodes[low, 5] + share * (nodes[low + 1, 5] - nodes[low, 5])
        for k in range(3):
            moved[k, i] = there[k, 0] * x + there[k, 1] * y + there[k, 2] * z + there[k, 3]
    return moved


@dataclass(frozen=True, slots=True, eq=False)
class Leap:
    """What the IMU says of the way from one moment to another, in base_link's axes at the first.

    ``rotation`` (3, 3) is R_first_second; ``velocity`` (3,) m/s and ``position`` (3,) m are what
    the specific force adds to them in ``seconds``; gravity and the velocity at first do the rest.
    """

    seconds: float
    rotation: Array
    velocity: Array
    position: Array


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """Integrals of an IMU's samples.

    Attributes:
        seconds: Nodes (K,), seconds after the sweep's stamp, in order.
        rotations: Rotations (K, 3, 3) from base_link at the first node to base_link at each.
        velocities: Integral (K, 3) of the specific force, in the first node's axes, m/s.
        positions: Integral (K, 3) of that, metres.
        arm: The IMU in base_link (3,), metres.
    """

    seconds: Array
    rotations: Array
    velocities: Array
    positions: Array
    arm: Array

    def leap(self, start: float, end: float) -> Leap:
        """The way between two moments, which must be nodes."""
        first, second = self._node(start), self._node(end)
        back = self.rotations[first].T
        passed = float(self.seconds[second] - self.seconds[first])
        position = self.positions[second] - self.positions[first] - self.velocities[first] * passed
        return Leap(
            passed,
            back @ self.rotations[second],
            back @ (self.velocities[second] - self.velocities[first]),
            back @ position,
        )

    def _node(self, moment: float) -> int:
        """The node at a moment."""
        return int(np.abs(self.seconds - moment).argmin())

    def hardest(self) -> float:
        """The largest mean of the specific force over ``BRIEF`` seconds or more, m/s^2."""
        last = len(self.seconds) - 1
        ends = np.searchsorted(self.seconds, self.seconds + BRIEF - 1e-9)
        # What is shorter as a whole is one stretch.
        starts = np.arange(max(int((ends <= last).sum()), 1))
        ends = np.minimum(ends[starts], last)
        changes = self.velocities[ends] - self.velocities[starts]
        passed = self.seconds[ends] - self.seconds[starts]
        return float((np.linalg.norm(changes, axis=1) / passed).max())

    def mean_force(self, moment: float) -> Array:
        """Mean specific force (3,), m/s^2, over the strip in base_link's axes at a moment."""
        passed = float(self.seconds[-1] - self.seconds[0])
        back = self.rotations[self._node(moment)].T
        mean: Array = back @ (self.velocities[-1] / passed)
        return mean

    def motion(self, moment: float, velocity: Array, gravity: Array) -> InertialMotion:
        """The motion around a moment that is a node.

        Args:
            moment: Seconds after the sweep's stamp.
            velocity: Of the IMU (3,) in base_link's axes at the moment, m/s.
            gravity: Gravity (3,) in base_link's axes at the moment, m/s^2.
        """
        node = self._node(moment)
        since = (self.seconds - self.seconds[node])[:, None]
        back = self.rotations[node].T
        rotations = back @ self.rotations
        forced = (self.positions - self.positions[node] - self.velocities[node] * since) @ back.T
        turns = np.array([gtsam.Rot3.Logmap(gtsam.Rot3(rotation)) for rotation in rotations])
        imu = velocity * since + 0.5 * gravity * since**2 + forced
        return InertialMotion(
            moment,
            self.seconds,
            np.hstack([turns, imu + self.arm - rotations @ self.arm]),
        )


def make_strip(
    series: ImuSeries,
    stamp: int,
    moments: Iterable[float],
    arm: Array,
    max_gap: float,
) -> Strip | None:
    """Integrate an IMU's samples over some moments.

    Args:
        series: Samples in base_link's axes, without the gyroscope's bias.
        stamp: Stamp of the sweep, ns.
        moments: Seconds after the stamp, two different ones at least: they become nodes, and the
            strip reaches from the first to the last.
        arm: The IMU in base_link (3,), metres.
        max_gap: Longest hole between samples, and between them and an end, in seconds.

    Returns:
        The strip; None where the samples do not cover it.
    """
    own = np.unique(np.array(list(moments)))
    # Stamps are subtracted as integers: doubles hold epoch nanoseconds to 256 ns only.
    known = (series.stamps - stamp) / NANOSECONDS
    near = slice(*np.searchsorted(known, (own[0] - max_gap, own[-1] + max_gap)).tolist())
    known = known[near]
    if len(known) == 0 or own[-1] == own[0]:
        return None
    inside = known[(known > own[0]) & (known < own[-1])]
    reach = np.concatenate([[max(own[0], known[0])], inside, [min(own[-1], known[-1])]])
    if (
        known[0] - own[0] > max_gap
        or own[-1] - known[-1] > max_gap
        or np.diff(reach).max() > max_gap
    ):
        return None
    seconds = np.union1d(own, inside)
    columns = np.hstack([series.gyro[near], series.acceleration[near]]).T
    at = np.stack([np.interp(seconds, known, column) for column in columns]).T
    steps = np.diff(seconds)[:, None]
    turned = rotations_after(0.5 * (at[1:, :3] + at[:-1, :3]) * steps)
    forces = np.einsum('kij,kj->ki', turned, at[:, 3:])
    velocities = _sums(0.5 * (forces[1:] + forces[:-1]) * steps)
    positions = _sums(velocities[:-1] * steps + (forces[:-1] / 3.0 + forces[1:] / 6.0) * steps**2)
    return Strip(seconds, turned, velocities, positions, arm)


def warm_up() -> None:
    """Compile the kernels, or load them from disk."""
    rotations_after(np.zeros((1, 3)))
    _moved(np.zeros((3, 1)), np.zeros(1), np.arange(2.0), np.zeros((2, 6)), np.eye(4))


@kernel
def rotations_after(turns: Array) -> Array:
    """Rotations (K, 3, 3) after each of some small turns (K - 1, 3), one after the other."""
    rotations = np.empty((len(turns) + 1, 3, 3))
    rotations[0] = np.eye(3)
    step = np.empty((3, 3))
    for i in range(len(turns)):
        x, y, z = turns[i, 0], turns[i, 1], turns[i, 2]
        once, twice = _rodrigues(x * x + y * y + z * z)
        step[0, 0] = 1.0 - twice * (y * y + z * z)
        step[1, 1] = 1.0 - twice * (x * x + z * z)
        step[2, 2] = 1.0 - twice * (x * x + y * y)
        step[0, 1], step[1, 0] = twice * x * y - once * z, twice * x * y + once * z
        step[0, 2], step[2, 0] = twice * x * z + once * y, twice * x * z - once * y
        step[1, 2], step[2, 1] = twice * y * z - once * x, twice * y * z + once * x
        for row in range(3):
            for column in range(3):
                rotations[i + 1, row, column] = (
                    rotations[i, row, 0] * step[0, column]
                    + rotations[i, row, 1] * step[1, column]
                    + rotations[i, row, 2] * step[2, column]
                )
    return rotations


def _sums(steps: Array) -> Array:
    """Sums (K, 3) of steps (K - 1, 3), from zero on."""
    return np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
