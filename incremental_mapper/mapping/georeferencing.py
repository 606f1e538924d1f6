"""From a local map to ENU: the yaw comes from the GNSS track once the car has moved.

Until then ENU is laid into the map without a turn, and a fix is trusted the less the further the
car has moved since the first one: a wrong yaw puts it at most twice that far away.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Config
from incremental_mapper.frontend.gnss import align_track
from incremental_mapper.geometry import pose_matrix
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    constant_velocity_prior,
    gnss_factor,
    pose_prior,
    velocity_prior,
)
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.smoothing.batch import make_graph, optimize
from incremental_mapper.smoothing.graph_state import GraphState
from incremental_mapper.smoothing.marginal_prior import MarginalPrior
from incremental_mapper.smoothing.smoother import marginal_prior_of
from incremental_mapper.variables import insert_moved, pose_key

MOST_FIXES = 40
"""Newest fixes that are looked at for a track; a car may stand for long before it moves."""
DISAGREEMENT = 5.0
"""How many times longer a way may be by the fixes than by odometry, or the other way round: the
worst matcher under-reads by so much."""
SLACK = 1.0
"""Metres by which the two may differ in any case."""


def agreeing_track(
    enu: NDArray[np.float64],
    local: NDArray[np.float64],
    sigmas: NDArray[np.float64],
    min_distance: float,
) -> NDArray[np.intp] | None:
    """Which fixes tell the yaw, by their positions; None as long as none do.

    ``enu`` and ``local`` (K, 3) are where the fixes and where odometry put the antenna, metres;
    ``sigmas`` (K,) are the fixes' standard deviations. Two fixes agree where both say about the
    same of the way between them; the largest set that agrees with one of its own is the track.
    It must stand out from its noise. A fix that is far off agrees with no other.
    """
    there = np.linalg.norm((enu[:, None] - enu)[..., :2], axis=-1)
    here = np.linalg.norm((local[:, None] - local)[..., :2], axis=-1)
    noise = np.hypot(sigmas[:, None], sigmas)
    slack = 5.0 * noise + SLACK
    agree = (there <= DISAGREEMENT * here + slack) & (here <= DISAGREEMENT * there + slack)
    anchor = int(agree.sum(axis=1).argmax())
    far = agree[anchor] & (there[anchor] > np.maximum(min_distance, 5.0 * noise[anchor]))
    return np.flatnonzero(agree[anchor]) if far.any() else None


def georeference(state: GraphState, config: Config) -> bool:
    """Turn all of G(t) into ENU by its GNSS track, and solve it again with full-weight fixes.

    Returns whether it was done. Costs one solve of all of G(t), once in a drive.
    """
    if state.georeferenced or len(state.fixes) < 2:
        return False
    latest = state.fixes[-MOST_FIXES:]
    enu = np.array([fix.enu for fix in latest])
    local = np.array([state.pose(fix.cluster).transformFrom(fix.lever_arm) for fix in latest])
    sigmas = np.sqrt([fix.covariance[0, 0] for fix in latest])
    track = agreeing_track(enu, local, sigmas, config.fixes.min_distance)
    if track is None:
        return False
    yaw, shift = align_track(enu[track], local[track], sigmas[track])
    T_enu_map = gtsam.Pose3(gtsam.Rot3.Yaw(yaw), shift)
    turned = turn_values(state.all_values(), T_enu_map)
    middle = local[track].mean(axis=0)
    factors = [turn_prior(factor, T_enu_map, config, middle) for factor in state.factors.unpacked()]
    for fix in state.fixes:
        factors[fix.factor] = gnss_factor(
            factors[fix.factor].keys[0],
            fix.enu,
            fix.covariance,
            fix.lever_arm,
            config.fixes.robust_threshold,
            factors[fix.factor].sensor or 'gnss',
            fix.stamp,
        )
    prior, older = _solved(state, factors, turned, config)
    state.turn_to_enu(T_enu_map, factors, prior, older)
    return True


def without_fixes(
    state: GraphState,
    config: Config,
    refuted: Collection[int],
    moved: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> None:
    """Take fixes out of G(t) that proved wrong, and solve it again; it is not ENU any more.

    Costs one solve of all of G(t), a few times in a drive at the most.

    Args:
        state: G(t).
        config: All settings.
        refuted: Stamps of the wrong fixes, ns.
        moved: Moves positions (3,) in ENU to the datum of the fixes that are left.
    """
    gone = {fix.factor for fix in state.fixes if fix.stamp in refuted}
    places = np.cumsum([place not in gone for place in range(len(state.factors))]) - 1
    fixes = [
        replace(fix, enu=moved(fix.enu), factor=int(places[fix.factor]))
        for fix in state.fixes
        if fix.factor not in gone
    ]
    factors = [factor for place, factor in enumerate(state.factors.unpacked()) if place not in gone]
    values = state.all_values()
    offset: NDArray[np.float64] | None = None
    for fix in fixes:
        antenna = values.atPose3(pose_key(fix.cluster)).transformFrom(fix.lever_arm)
        offset = antenna - fix.enu if offset is None else offset
        spread = 2.0 * float(np.linalg.norm((fix.enu - fixes[0].enu)[:2]))
        factors[fix.factor] = gnss_factor(
            factors[fix.factor].keys[0],
            fix.enu + offset,
            fix.covariance + np.diag([spread**2, spread**2, 0.0]),
            fix.lever_arm,
            config.fixes.robust_threshold,
            factors[fix.factor].sensor or 'gnss',
            fix.stamp,
        )
    prior, older = _solved(state, factors, values, config)
    state.refound(factors, fixes, offset, prior, older)


def turn_values(values: gtsam.Values, T_enu_map: gtsam.Pose3) -> gtsam.Values:
    """Poses and velocities in another frame; biases are the vehicle's own.

    Args:
        values: Any.
        T_enu_map: To the other frame.
    """
    turned = gtsam.Values()
    for key in values.keys():  # noqa: SIM118 (no mapping)
        insert_moved(values, key, T_enu_map, turned)
    return turned


def _solved(
    state: GraphState, factors: Sequence[Factor], initial: gtsam.Values, config: Config
) -> tuple[MarginalPrior, gtsam.Values]:
    """All of G(t) solved again: its newest part, and the variables that have left it."""
    plain = tuple(factor.factor for factor in (*factors, *state.closures))
    solution = optimize(make_graph(plain), initial, 100)
    clusters = {placed.id: placed.cluster.stamp for placed in state.clusters}
    newest = max(clusters.values())
    return marginal_prior_of(
        plain,
        initial if solution is None else solution.values,
        clusters,
        state.frontier.keys(),
        newest - round(config.graph.lag * NANOSECONDS),
    )


def turn_prior(
    factor: Factor,
    T_enu_map: gtsam.Pose3,
    config: Config,
    middle: NDArray[np.float64] | None = None,
) -> Factor:
    """What says something of a pose or velocity in the map, under the new frame; not of fixes.

    Position and yaw of the priors are only loosely held from here on: the fixes know better.

    Args:
        factor: Any.
        T_enu_map: To the new frame.
        config: All settings.
        middle: Of what told the new frame (3,), in the map, metres: a wrong turn about it moves a
            prior the further the further away that is. None where the turn is certain.
    """
    if factor.kind is FactorKind.PRIOR_POSE:
        graph = config.graph
        data = factor.data
        before = gtsam.Pose3(pose_matrix(data['T_map_base']))
        far = 0.0 if middle is None else float(np.linalg.norm(before.translation() - middle))
        position = max(graph.weak_sigma_position, graph.prior_sigma_yaw * far)
        sigmas = np.maximum(
            np.array(data['sigmas']), [0.0, 0.0, graph.prior_sigma_yaw] + [position] * 3
        )
        pose = T_enu_map.compose(before)
        return pose_prior(factor.keys[0], pose, sigmas, factor.stamps[0])
    if factor.kind is FactorKind.PRIOR_VELOCITY:
        data = factor.data
        velocity = T_enu_map.rotation().rotate(np.array(data['velocity']))
        return velocity_prior(factor.keys[0], velocity, data['sigma'], factor.stamps[0])
    if factor.kind is FactorKind.CONSTANT_VELOCITY:
        data, (first, second), (start, end) = factor.data, factor.keys, factor.stamps
        change = T_enu_map.rotation().rotate(np.array(data['change']))
        return constant_velocity_prior((first, second), change, data['sigma'], (start, end))
    return factor
