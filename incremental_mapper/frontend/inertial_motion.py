"""How base_link moves around a sweep by the IMU: rotation, and translation from a velocity.

Rates and forces are integrated once, free of velocity and gravity; these are laid over them where
they are known, so that a better velocity costs no second integration.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

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
        low = np.clip(np.searchsorted(self.seconds, times) - 1, 0, len(self.seconds) - 2)
        share = (times - self.seconds[low]) / np.diff(self.seconds)[low]
        nodes = self.nodes.T
        table = nodes.take(low, axis=1) + share * np.diff(nodes, axis=1).take(low, axis=1)
        moved = _rotated(table[:3], rows) + table[3:]
        if moment != self.moment:
            there = self.between(moment, self.moment)
            moved = there.rotation().matrix() @ moved + there.translation()[:, None]
        return moved

    def _pose(self, seconds: float) -> gtsam.Pose3:
        low = min(max(int(self.seconds.searchsorted(seconds)) - 1, 0), len(self.seconds) - 2)
        start, end = self.seconds[low : low + 2].tolist()
        share = min(max((seconds - start) / (end - start), 0.0), 1.0)
        node = self.nodes[low] + share * (self.nodes[low + 1] - self.nodes[low])
        return gtsam.Pose3(gtsam.Rot3.Expmap(node[:3]), node[3:])


def _rotated(turns: Array, rows: Array) -> Array:
    """Points (3, N), each turned by its own rotation vector (3, N)."""
    once, twice = _rodrigues((turns * turns).sum(axis=0))
    cross = _cross(turns, rows)
    rotated: Array = rows + once * cross + twice * _cross(turns, cross)
    return rotated


def _rodrigues(square: Array) -> tuple[Array, Array]:
    """sin(a)/a and (1 - cos(a))/a^2 for squares of angles (N,), rad^2."""
    if square.max(initial=0.0) < SMALL:  # several times as quick, and as exact
        once = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
        twice = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
        return once, twice
    angle = np.sqrt(square) / (2.0 * np.pi)
    return np.sinc(2.0 * angle), 0.5 * np.sinc(angle) ** 2


def _cross(one: Array, other: Array) -> Array:
    """Cross products of columns (3, N): several times as quick as NumPy's own."""
    return np.stack(
        [
            one[1] * other[2] - one[2] * other[1],
            one[2] * other[0] - one[0] * other[2],
            one[0] * other[1] - one[1] * other[0],
        ]
    )


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
    turns = 0.5 * (at[1:, :3] + at[:-1, :3]) * steps
    rotation, rotations = gtsam.Rot3(), [np.eye(3)]
    for turn in turns:
        rotation = rotation.compose(gtsam.Rot3.Expmap(turn))
        rotations.append(rotation.matrix())
    turned = np.array(rotations)
    forces = np.einsum('kij,kj->ki', turned, at[:, 3:])
    velocities = _sums(0.5 * (forces[1:] + forces[:-1]) * steps)
    positions = _sums(velocities[:-1] * steps + (forces[:-1] / 3.0 + forces[1:] / 6.0) * steps**2)
    return Strip(seconds, turned, velocities, positions, arm)


def _sums(steps: Array) -> Array:
    """Sums (K, 3) of steps (K - 1, 3), from zero on."""
    return np.vstack([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
