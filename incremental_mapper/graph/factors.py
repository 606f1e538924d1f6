"""Factors: a GTSAM factor together with what it was made of."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Any, TypeAlias

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from incremental_mapper.config import GraphSettings
from incremental_mapper.geometry import matrix_numbers
from incremental_mapper.variables import bias_key, pose_key, velocity_key


class FactorKind(StrEnum):
    """Kinds of factors, as files and statistics name them."""

    ODOMETRY = 'odometry'
    GNSS = 'gnss'
    IMU = 'imu'
    PRIOR_POSE = 'prior_pose'
    PRIOR_VELOCITY = 'prior_velocity'
    PRIOR_BIAS = 'prior_bias'
    CONSTANT_VELOCITY = 'continuity_velocity'
    BIAS_RANDOM_WALK = 'continuity_bias'
    BRIDGE = 'bridge'
    CLOSURE = 'closure'
    DEAD_RECKONING = 'dead_reckoning'
    IMU_PART = 'imu_part'


BETWEEN_STATES = frozenset({FactorKind.CONSTANT_VELOCITY, FactorKind.BIAS_RANDOM_WALK})
"""What carries velocity and bias over to a chain of IMU spans that starts anew."""


Describe: TypeAlias = Callable[[Any], dict[str, Any]]
"""Reads plain numbers, and poses, from a factor, whose own GTSAM class only its maker knows."""


def _describe_nothing(factor: gtsam.NonlinearFactor) -> dict[str, Any]:
    return {}


@dataclass(frozen=True, slots=True, eq=False)
class Factor:
    """One factor of G(t).

    ``stamps`` are the stamps (ns) of the measurements that it was made of. ``describe`` reads
    the measured values and their noise back from the GTSAM factor, so that millions of factors
    need not keep them twice.
    """

    kind: FactorKind
    keys: tuple[int, ...]
    factor: gtsam.NonlinearFactor
    sensor: str | None = None
    stamps: tuple[int, ...] = ()
    describe: Describe = _describe_nothing

    @property
    def data(self) -> dict[str, Any]:
        """The measured values and their noise in plain numbers, for the export."""
        return factors_data([self])[0]


UPPER = np.triu_indices(6)
"""Places of the upper triangle of a covariance, row by row, which stands for all of it."""


def pose_numbers(pose: gtsam.Pose3) -> list[float]:
    """Position and quaternion x, y, z, qx, qy, qz, qw of a pose."""
    return matrix_numbers(pose.matrix())


def poses_numbers(poses: Sequence[gtsam.Pose3]) -> list[list[float]]:
    """``pose_numbers`` of many poses: the same to the bit, at a twentieth of the time for each."""
    if not poses:
        return []
    matrices = np.array([pose.matrix() for pose in poses])
    turns = Rotation.from_matrix(matrices[:, :3, :3]).as_quat()
    numbers: list[list[float]] = np.hstack([matrices[:, :3, 3], turns]).tolist()
    return numbers


def factors_data(factors: Iterable[Factor]) -> list[dict[str, Any]]:
    """``data`` of many factors."""
    trees = [factor.describe(factor.factor) for factor in factors]
    places = [
        (tree, name) for tree in trees for name in tree if isinstance(tree[name], gtsam.Pose3)
    ]
    numbers = poses_numbers([tree[name] for tree, name in places])
    for (tree, name), plain in zip(places, numbers, strict=True):
        tree[name] = plain
    return trees


def pose_sigmas(translation: float, rotation: float) -> NDArray[np.float64]:
    """Standard deviations (6,) in the order of GTSAM's Pose3 tangent: rotation first."""
    return np.array([rotation] * 3 + [translation] * 3)


def between_factor(
    kind: FactorKind,
    keys: tuple[int, int],
    T_first_second: gtsam.Pose3,
    covariance: NDArray[np.float64],
    sensor: str | None,
    stamps: tuple[int, int],
) -> Factor:
    """Relative pose of two clusters: odometry, dead reckoning, or a bridge over missing data.

    ``covariance`` (6, 6) is that of ``T_first_second`` in the frame of the second, rotation first.
    """
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return Factor(
        kind=kind,
        keys=keys,
        factor=gtsam.BetweenFactorPose3(*keys, T_first_second, noise),
        sensor=sensor,
        stamps=stamps,
        describe=_describe_between,
    )


def _describe_between(factor: Any) -> dict[str, Any]:
    noise = factor.noiseModel()
    told: dict[str, Any] = {
        'T_first_second': factor.measured(),
        'sigmas': noise.sigmas().tolist(),
    }
    if not isinstance(noise, gtsam.noiseModel.Diagonal):
        told['covariance'] = noise.covariance()[UPPER].tolist()
    return told


def closure_factor(
    keys: tuple[int, int],
    T_first_second: gtsam.Pose3,
    covariance: NDArray[np.float64],
    robust_threshold: float,
    stamps: tuple[int, int],
) -> Factor:
    """Relative pose of two clusters that saw the same place, under a robust loss.

    ``covariance`` (6, 6) is that of ``T_first_second`` in the frame of the second, rotation first;
    ``robust_threshold`` is Huber's, in standard deviations, 0 for none.
    """
    noise = _robust(gtsam.noiseModel.Gaussian.Covariance(covariance), robust_threshold)
    return Factor(
        kind=FactorKind.CLOSURE,
        keys=keys,
        factor=gtsam.BetweenFactorPose3(*keys, T_first_second, noise),
        stamps=stamps,
        describe=partial(_describe_closure, covariance),
    )


def _describe_closure(covariance: NDArray[np.float64], factor: Any) -> dict[str, Any]:
    return {
        'T_first_second': factor.measured(),
        'sigmas': np.sqrt(np.diag(covariance)).tolist(),
        'covariance': covariance[UPPER].tolist(),
    }


def _robust(noise: gtsam.noiseModel.Base, threshold: float) -> gtsam.noiseModel.Base:
    if threshold <= 0:
        return noise
    return gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(threshold), noise
    )


def gnss_factor(
    key: int,
    position: NDArray[np.float64],
    covariance: NDArray[np.float64],
    lever_arm: NDArray[np.float64],
    robust_threshold: float,
    sensor: str,
    stamp: int,
) -> Factor:
    """Antenna position (3,) in the map, metres; ``lever_arm`` (3,) is the antenna in base_link."""
    noise = _robust(gtsam.noiseModel.Gaussian.Covariance(covariance), robust_threshold)
    return Factor(
        kind=FactorKind.GNSS,
        keys=(key,),
        factor=gtsam.GPSFactorArm(key, position, lever_arm, noise),
        sensor=sensor,
        stamps=(stamp,),
        describe=partial(_describe_gnss, covariance, lever_arm),
    )


def _describe_gnss(
    covariance: NDArray[np.float64], lever_arm: NDArray[np.float64], factor: Any
) -> dict[str, Any]:
    return {
        'position': factor.measurementIn().tolist(),
        'covariance': covariance.tolist(),
        'lever_arm': lever_arm.tolist(),
    }


def imu_factor(
    start: int,
    end: int,
    preintegrated: gtsam.PreintegratedCombinedMeasurements | gtsam.PreintegratedImuMeasurements,
    sensor: str,
    span: tuple[int, int],
    samples: NDArray[np.int64],
    bias: int | None = None,
) -> Factor:
    """Pre-integrated span between two clusters.

    Args:
        start: Number of the cluster where it starts.
        end: Number of the cluster where it ends.
        preintegrated: The span: one with a constant bias, or one in which the bias walks from
            that of its start to that of its end.
        sensor: Name of the IMU.
        span: Stamps of the two clusters, ns.
        samples: Stamps (K,) of what it holds, ns.
        bias: Number of the cluster whose bias is the constant one; the start's by default.

    Returns:
        The factor.
    """
    x_start, v_start = pose_key(start), velocity_key(start)
    x_end, v_end = pose_key(end), velocity_key(end)
    factor: gtsam.NonlinearFactor
    if isinstance(preintegrated, gtsam.PreintegratedImuMeasurements):
        shared = bias_key(start if bias is None else bias)
        factor = gtsam.ImuFactor(x_start, v_start, x_end, v_end, shared, preintegrated)
    else:
        b_start, b_end = bias_key(start), bias_key(end)
        factor = gtsam.CombinedImuFactor(
            x_start, v_start, x_end, v_end, b_start, b_end, preintegrated
        )
    return Factor(
        kind=FactorKind.IMU,
        keys=tuple(factor.keys()),
        factor=factor,
        sensor=sensor,
        stamps=(int(samples[0]), int(samples[-1])),
        describe=describe_imu(span, len(samples)),
    )


def describe_imu(span: tuple[int, int], samples: int) -> Describe:
    """The ``Factor.describe`` of pre-integrated samples between two stamps (ns)."""
    return partial(_describe_imu, span, samples)


def _describe_imu(span: tuple[int, int], samples: int, factor: Any) -> dict[str, Any]:
    preintegrated = factor.preintegratedMeasurements()
    return {
        'span_ns': list(span),
        'samples': samples,
        'delta_t': preintegrated.deltaTij(),
        'delta_position': preintegrated.deltaPij().tolist(),
        'delta_velocity': preintegrated.deltaVij().tolist(),
        'delta_rotation_vector': gtsam.Rot3.Logmap(preintegrated.deltaRij()).tolist(),
        'bias_hat': preintegrated.biasHatVector().tolist(),
    }


def pose_prior(key: int, pose: gtsam.Pose3, sigmas: NDArray[np.float64], stamp: int) -> Factor:
    """Prior on a pose; ``sigmas`` (6,) are rotation first, in the body frame."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return Factor(
        kind=FactorKind.PRIOR_POSE,
        keys=(key,),
        factor=gtsam.PriorFactorPose3(key, pose, noise),
        stamps=(stamp,),
        describe=_describe_pose_prior,
    )


def _describe_pose_prior(factor: Any) -> dict[str, Any]:
    return {
        'T_map_base': factor.prior(),
        'sigmas': factor.noiseModel().sigmas().tolist(),
    }


def velocity_prior(key: int, velocity: NDArray[np.float64], sigma: float, stamp: int) -> Factor:
    """Prior on a velocity (3,) in the map with standard deviation ``sigma``, m/s."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    return Factor(
        kind=FactorKind.PRIOR_VELOCITY,
        keys=(key,),
        factor=gtsam.PriorFactorVector(key, velocity, noise),
        stamps=(stamp,),
        describe=_describe_velocity_prior,
    )


def _describe_velocity_prior(factor: Any) -> dict[str, Any]:
    return {
        'velocity': factor.prior().tolist(),
        'sigma': float(factor.noiseModel().sigmas()[0]),
    }


def _describe_bias_prior(factor: Any) -> dict[str, Any]:
    return {
        'bias': factor.prior().vector().tolist(),
        'sigmas': factor.noiseModel().sigmas().tolist(),
    }


def bias_prior(
    key: int, bias: gtsam.imuBias.ConstantBias, settings: GraphSettings, stamp: int
) -> Factor:
    """Prior on a bias where nothing is known of an earlier one."""
    sigmas = np.array(
        [settings.prior_sigma_accelerometer_bias] * 3 + [settings.prior_sigma_gyroscope_bias] * 3
    )
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return Factor(
        kind=FactorKind.PRIOR_BIAS,
        keys=(key,),
        factor=gtsam.PriorFactorConstantBias(key, bias, noise),
        stamps=(stamp,),
        describe=_describe_bias_prior,
    )


def constant_velocity_prior(
    keys: tuple[int, int], change: NDArray[np.float64], sigma: float, stamps: tuple[int, int]
) -> Factor:
    """Velocity of two clusters with no IMU span between them: ``change`` (3,) in the map, m/s."""
    noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    return Factor(
        kind=FactorKind.CONSTANT_VELOCITY,
        keys=keys,
        factor=gtsam.BetweenFactorVector(*keys, change, noise),
        stamps=stamps,
        describe=_describe_constant_velocity,
    )


def _describe_constant_velocity(factor: Any) -> dict[str, Any]:
    return {
        'change': np.asarray(factor.measured()).tolist(),
        'sigma': float(factor.noiseModel().sigmas()[0]),
    }


def bias_random_walk(
    keys: tuple[int, int], sigmas: NDArray[np.float64], stamps: tuple[int, int]
) -> Factor:
    """Bias of two clusters with no IMU span between them; ``sigmas`` (6,) of its random walk."""
    noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return Factor(
        kind=FactorKind.BIAS_RANDOM_WALK,
        keys=keys,
        factor=gtsam.BetweenFactorConstantBias(*keys, gtsam.imuBias.ConstantBias(), noise),
        stamps=stamps,
        describe=_describe_random_walk,
    )


def _describe_random_walk(factor: Any) -> dict[str, Any]:
    return {'sigmas': factor.noiseModel().sigmas().tolist()}


def beside_gtsam(factor: Factor) -> dict[str, Any]:
    """What ``Factor.data`` has that the GTSAM factor does not hold, in plain values.

    Args:
        factor: Any factor of this room.
    """
    names = _BESIDE.get(factor.kind)
    data = factor.data if names else {}
    return {name: data[name] for name in names or ()}


_BESIDE = {
    FactorKind.GNSS: ('covariance', 'lever_arm'),
    FactorKind.IMU: ('span_ns', 'samples'),
    FactorKind.IMU_PART: ('span_ns', 'samples'),
    FactorKind.CLOSURE: ('covariance',),
}


def describer(kind: FactorKind, beside: Mapping[str, Any]) -> Describe:
    """The ``Factor.describe`` of a factor that was read from a file.

    Args:
        kind: Its kind.
        beside: What ``beside_gtsam`` told of it.
    """
    if kind is FactorKind.GNSS:
        covariance, arm = np.array(beside['covariance']), np.array(beside['lever_arm'])
        return partial(_describe_gnss, covariance, arm)
    if kind in (FactorKind.IMU, FactorKind.IMU_PART):
        start, end = beside['span_ns']
        return describe_imu((start, end), beside['samples'])
    if kind is FactorKind.CLOSURE:
        covariance = np.zeros((6, 6))
        covariance[UPPER] = beside['covariance']
        return partial(_describe_closure, np.triu(covariance) + np.triu(covariance, 1).T)
    return {
        FactorKind.ODOMETRY: _describe_between,
        FactorKind.BRIDGE: _describe_between,
        FactorKind.DEAD_RECKONING: _describe_between,
        FactorKind.PRIOR_POSE: _describe_pose_prior,
        FactorKind.PRIOR_VELOCITY: _describe_velocity_prior,
        FactorKind.PRIOR_BIAS: _describe_bias_prior,
        FactorKind.CONSTANT_VELOCITY: _describe_constant_velocity,
        FactorKind.BIAS_RANDOM_WALK: _describe_random_walk,
    }[kind]
