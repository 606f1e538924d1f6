"""Measurements of a vehicle that stands join the newest cluster: they add no variable."""

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import Prepared, PreparedFix
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.graph.factors import Factor, gnss_factor, velocity_prior
from incremental_mapper.mapping.standstill import SPAN
from incremental_mapper.measurements import NANOSECONDS, NO_VERTICAL_SIGMA
from incremental_mapper.quantiles import chi_squared
from incremental_mapper.selection.window_problem import fix_spread
from incremental_mapper.smoothing.graph_state import GraphState, PlacedFix
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import pose_key, velocity_key

STANDING_SIGMA = 0.02
"""m/s; standard deviation of the velocity of a vehicle that stands."""
NOTICED = SPAN
"""Nanoseconds after which it is noticed that a vehicle has set off. The span to come starts so much
earlier, where it stood for certain: one that pulls away at 0.03 m/s when its span starts, and is
said to stand there, came 26 mm less far within 1.5 s."""
SURPRISE = chi_squared(0.9999, 3)
"""Squared Mahalanobis distance beyond which a fix says that the vehicle stands elsewhere."""


def joinable(state: GraphState) -> bool:
    """Whether the newest cluster is one that measurements may join and a span may start from."""
    frontier = state.frontier
    return frontier.head is not None and frontier.head_inertial and frontier.head == frontier.newest


def join(
    state: GraphState, items: Sequence[Prepared], config: Config, samples: NDArray[np.int64]
) -> float | None:
    """Let measurements of a vehicle that stands join the newest cluster.

    Fixes become factors of its pose. Scans add nothing, neither factors nor points: the next
    ones are matched to them, from where the cluster is. The span to come starts ``NOTICED`` before
    the newest of the measurements, or behind a later hole of the IMU, which no span could cross. So
    the IMU's bias is taken as constant while the vehicle stands.

    Args:
        state: G(t-1), which becomes G(t); ``joinable``.
        items: The measurements, in time order, at least one.
        config: All settings.
        samples: Stamps (K,) of the IMU's samples since the span to come started so far, ns.

    Returns:
        Σ‖h(x)−z‖²_Σ of the new factors; None where a fix contradicts, and nothing has changed.
    """
    frontier = state.frontier
    assert frontier.head is not None
    head, arm = frontier.head, config.gnss.matrix()[:3, 3]
    pose, stamp = state.pose(head), max(items[-1].core.stamp, frontier.newest_stamp)
    fixes = [item for item in items if isinstance(item, PreparedFix)]
    antenna = pose.transformFrom(arm)
    offset = state.enu_offset
    if offset is None:
        offset = antenna - fixes[0].enu if fixes else np.zeros(3)
    spread = fix_spread(state, items)
    known = antenna_covariance(state, head, arm) if fixes else np.zeros((3, 3))
    made: list[Factor] = []
    placed: list[PlacedFix] = []
    for fix in fixes:
        wide, upward = spread.get(fix.core.stamp, (0.0, 0.0))
        covariance = fix.covariance + np.diag([wide**2, wide**2, upward**2])
        if _surprising(antenna - (fix.enu + offset), covariance + known):
            return None
        place = len(state.factors) + len(made)
        made.append(
            gnss_factor(
                pose_key(head),
                fix.enu + offset,
                covariance,
                arm,
                config.fixes.robust_threshold,
                fix.core.sensor,
                fix.core.stamp,
            )
        )
        placed.append(PlacedFix(head, fix.core.stamp, fix.enu, fix.covariance, arm, place))
    if not state.clusters[head].joined:
        made.append(velocity_prior(velocity_key(head), np.zeros(3), STANDING_SIGMA, stamp))
    prior, _ = smoother_update(
        state.prior,
        [factor.factor for factor in made],
        gtsam.Values(),
        {head: stamp},
        config.graph.max_iterations,
    )
    if fixes:
        state.define_enu(offset)
    error = sum(2.0 * factor.factor.error(prior.values) for factor in made)
    state.add_joined(head, [item.core for item in items], placed)
    state.add_factors(made, prior)
    scans = [item.core for item in items if isinstance(item, PreparedScan) and item.usable]
    chains = {**frontier.chains, **{core.sensor: (head, core.stamp) for core in scans}}
    max_gap = round(config.odometry.max_gap * NANOSECONDS)
    longest = round(config.preintegration.max_gap * NANOSECONDS)
    stood = _behind_holes(samples, max(frontier.head_stamp, stamp - NOTICED), stamp, longest)
    state.advance(
        replace(
            frontier,
            chains={name: chain for name, chain in chains.items() if stamp - chain[1] <= max_gap},
            head_stamp=stood,
            inertial_stamp=stood,
            newest_stamp=stamp,
        ),
        np.zeros(3),
        stamp - round(config.graph.lag * NANOSECONDS),
    )
    return error


def _behind_holes(samples: NDArray[np.int64], start: int, end: int, longest: int) -> int:
    """The first stamp from ``start`` on, ns, from which samples go on to ``end`` without a hole."""
    inside = samples[(samples >= start) & (samples < end)]
    stamps = np.array([start, *inside, end])
    holes = np.flatnonzero(np.diff(stamps) > longest)
    return int(stamps[holes[-1] + 1]) if len(holes) else start


def antenna_covariance(
    state: GraphState, cluster: int, arm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Covariance (3, 3) of the antenna's position in the map, m^2.

    Args:
        state: G(t).
        cluster: One of the frontier.
        arm: The antenna in base_link (3,), metres.
    """
    covariance = state.prior.covariance(pose_key(cluster))
    if covariance is None:
        return np.eye(3) * NO_VERTICAL_SIGMA**2
    R_map_base = state.pose(cluster).rotation().matrix()
    jacobian = R_map_base @ np.hstack([-gtsam.Rot3.Hat(arm), np.eye(3)])
    moved: NDArray[np.float64] = jacobian @ covariance @ jacobian.T
    return moved


def _surprising(apart: NDArray[np.float64], covariance: NDArray[np.float64]) -> bool:
    return bool(apart @ np.linalg.solve(covariance, apart) > SURPRISE)
