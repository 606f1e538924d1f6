"""What is learned late of older variables, carried on to the frontier of today.

While something is found out about the graph as it was (a closed loop), the smoother goes on. So the
frontier of that time is held: it is eliminated as always, and it stays known how it moves with the
frontier of today, and by how much it does not (``MarginalPrior.spread``). Evidence on it then
becomes evidence on the frontier: exact where all is linear, and nothing older is needed.

Loops move a map by metres and degrees, for which a linear step is too coarse. So the newest part is
moved as a rigid body first (``moved``): what it knows of itself stays the same to the digit, and
what it knows of places pulls it back with the strength that it had.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from scipy.linalg import block_diag, eigh

from incremental_mapper.smoothing.batch import eliminate, make_graph
from incremental_mapper.smoothing.linear_system import Array, layout_of, solve_scaled
from incremental_mapper.smoothing.marginal_prior import MarginalPrior, triangle
from incremental_mapper.smoothing.tangent import Pivoted, retracted
from incremental_mapper.variables import cluster_of, kind_of

SHARE = 1e-6
"""Share of what is known in a direction below which evidence on it is rounding."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """A likelihood of variables: of GTSAM's step δ (n,) away from ``values``, ‖rows · δ − rhs‖².

    Attributes:
        keys: The variables.
        values: Where it is linear.
        rows: Square-root information (k, n).
        rhs: Right-hand side (k,).
        T_new_old: The motion in the map that leads the newest pose to where it is in ``values``.
    """

    keys: tuple[int, ...]
    values: gtsam.Values
    rows: Array
    rhs: Array
    T_new_old: gtsam.Pose3


def hold(prior: MarginalPrior) -> MarginalPrior:
    """Hold the frontier as it is now, in place of any that is held.

    Args:
        prior: The prior.

    Returns:
        The same Gaussian.
    """
    size = layout_of(prior.keys).size
    return replace(prior, held=prior.keys, spread=np.zeros((size, size)))


def release(prior: MarginalPrior) -> MarginalPrior:
    """Hold nothing any more."""
    return replace(prior, held=(), spread=np.zeros((0, 0)))


def evidence_on(
    prior: MarginalPrior,
    values: gtsam.Values,
    before: Sequence[gtsam.NonlinearFactor],
    after: Sequence[gtsam.NonlinearFactor],
) -> Evidence:
    """What new factors of a graph say of its frontier, all other variables marginalised.

    Args:
        prior: What the graph says of its frontier without them.
        values: All variables at the optimum with ``after``.
        before: All factors without those that are new.
        after: All factors.

    Returns:
        The evidence that moves the prior's mean to ``values``, as strong as the new factors are.
        Where ``after`` lacks some of ``before``, directions in which less is known than before are
        left out: evidence cannot be taken back.
    """
    keys = list(prior.keys)
    information = _information(keys, values, after)
    gained = information - _information(keys, values, before)
    # Generalised eigenvalues are shares of what is known, whatever the units.
    shares, directions = eigh(0.5 * (gained + gained.T), information)
    kept = shares > SHARE
    directions, root = directions[:, kept], np.sqrt(shares[kept])
    T_new_old = _motion(prior, values)
    there = moved(prior, T_new_old)
    # Linear around different values, the two would not quite agree on where the mean is.
    known = np.linalg.solve(there.own_steps().T, there.root.T).T  # over GTSAM's steps
    pull = known.T @ (there.rhs + known @ _apart(values, there.base, prior.keys))
    return Evidence(
        keys=prior.keys,
        values=values.extract(keys),
        rows=root[:, None] * (directions.T @ information),
        rhs=-(directions.T @ pull) / root,
        T_new_old=T_new_old,
    )


def _information(
    keys: Sequence[int], values: gtsam.Values, factors: Sequence[gtsam.NonlinearFactor]
) -> Array:
    """Information (n, n) of a graph's marginal, linear at ``values``."""
    dropped = sorted(set(values.keys()) - set(keys), key=cluster_of)
    split = eliminate(make_graph(factors), values, dropped)
    linear = make_graph(split.factors).linearize(values)
    jacobian, _ = linear.jacobian()
    rows = np.zeros((len(jacobian), layout_of(tuple(keys)).size))
    rows[:, layout_of(tuple(keys)).columns(linear.keyVector())] = jacobian
    return rows.T @ rows


def _motion(prior: MarginalPrior, values: gtsam.Values) -> gtsam.Pose3:
    """What leads the frontier's newest pose to where ``values`` have it."""
    poses = [key for key in prior.keys if kind_of(key) == 'x']
    if not poses:
        return gtsam.Pose3()
    newest = max(poses, key=lambda key: prior.clusters[cluster_of(key)])
    return values.atPose3(newest).compose(prior.base.atPose3(newest).inverse())


def _apart(first: gtsam.Values, second: gtsam.Values, keys: tuple[int, ...]) -> Array:
    """Tangent steps (n,) from the one estimate of some variables to the other."""
    steps = first.extract(list(keys)).localCoordinates(second.extract(list(keys)))
    return np.concatenate([np.zeros(0), *(steps.at(key) for key in keys)])


def moved(prior: MarginalPrior, T_new_old: gtsam.Pose3) -> MarginalPrior:
    """Move all variables of a prior as a rigid body; what it says stays the same.

    What it says of the variables among each other moves along. What it says of places stays where
    it was, and draws the moved variables back.

    Args:
        prior: The prior.
        T_new_old: In the map.

    Returns:
        The same Gaussian around the moved estimates.
    """
    base = gtsam.Values(prior.base)
    for key in base.keys():  # noqa: SIM118 (no mapping)
        if kind_of(key) == 'x':
            base.update(key, T_new_old.compose(base.atPose3(key)))
        elif kind_of(key) == 'v':
            base.update(key, T_new_old.rotation().rotate(base.atVector(key)))
    turn = T_new_old.rotation().matrix()
    frontier = _turned(prior.keys, turn, poses=True)
    eliminated, held = _turned(prior.eliminated, turn), _turned(prior.held, turn)
    root = prior.root @ frontier.T
    gains = eliminated @ prior.gains @ frontier.T
    twist = gtsam.Pose3.Logmap(T_new_old)
    pivot = T_new_old.transformFrom(prior.pivot)
    went, followed = _rigid(prior.keys, base, twist, pivot), _steps(prior.eliminated, base, twist)
    return replace(
        prior,
        root=root,
        rhs=prior.rhs - root @ went,
        pivot=pivot,
        gains=gains,
        base=base,
        pending_delta=eliminated @ prior.pending_delta + gains @ went - followed,
        spread=held @ prior.spread @ held.T,
    )


def with_evidence(prior: MarginalPrior, evidence: Evidence) -> MarginalPrior:
    """Take in what was learned of the held variables, and move all with them.

    Args:
        prior: Holds the evidence's variables.
        evidence: On them.

    Returns:
        The prior with it, solved, which holds them no longer.
    """
    prior = moved(prior, evidence.T_new_old)
    gains, pending = prior.following(evidence.keys)
    offset = _apart(evidence.values, prior.base, evidence.keys) + pending
    # What the frontier does not tell of them is noise of the evidence.
    noise = np.eye(len(evidence.rows)) + evidence.rows @ prior.spread @ evidence.rows.T
    whiten = np.linalg.inv(np.linalg.cholesky(noise))
    rows = whiten @ evidence.rows @ gains
    rhs = whiten @ (evidence.rhs - evidence.rows @ offset)
    root, rest = triangle(np.vstack([prior.root, rows]), np.concatenate([prior.rhs, rhs]))
    step = solve_scaled(root.T @ root, root.T @ rest)
    grown = replace(release(prior), root=root, rhs=rest)
    if step is None:
        return grown  # the next window takes it from here
    base = gtsam.Values(prior.base)
    layout = layout_of(prior.keys)
    here = Pivoted(base.extract(layout.keys), prior.pivot)
    base.update(retracted(here, layout, step))
    return replace(
        grown,
        rhs=rest - root @ step,
        base=base,
        pending_delta=prior.pending_delta + prior.gains @ step,
    )


def _turned(keys: Sequence[int], turn: Array, poses: bool = False) -> Array:
    """Steps in the new map by those in the old one: velocities turn, and poses about a pivot."""
    both = block_diag(turn, turn)
    kinds = {'x': both if poses else np.eye(6), 'v': turn, 'b': np.eye(6)}
    blocks = [kinds[kind_of(key)] for key in keys]
    return block_diag(*blocks) if blocks else np.zeros((0, 0))


def _rigid(keys: tuple[int, ...], values: gtsam.Values, twist: Array, pivot: Array) -> Array:
    """Steps (n,) about a pivot of variables that move as a rigid body by a twist of the map."""
    layout, step = layout_of(keys), _steps(keys, values, twist)
    for _, place in layout.poses:
        step[place] = np.concatenate([twist[:3], twist[3:] + np.cross(twist[:3], pivot)])
    for velocity in layout.velocities:
        step[velocity.place] = 0.0
    return step


def _steps(keys: Sequence[int], values: gtsam.Values, twist: Array) -> Array:
    """GTSAM's steps (n,) of variables that move as a rigid body by a twist (6,) of the map."""
    steps = [np.zeros(0)]
    for key in keys:
        if kind_of(key) == 'x':
            steps.append(values.atPose3(key).inverse().AdjointMap() @ twist)
        elif kind_of(key) == 'v':
            steps.append(np.cross(twist[:3], values.atVector(key)))
        else:
            steps.append(np.zeros(6))
    return np.concatenate(steps)
