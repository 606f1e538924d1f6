"""What factors say of themselves, one by one and all together."""

import gtsam
import numpy as np

from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    factors_data,
    gnss_factor,
    pose_numbers,
    pose_prior,
    poses_numbers,
)
from incremental_mapper.variables import pose_key

SIGMAS = np.full(6, 0.1)
NOISE = 0.01 * (np.eye(6) + 0.1)


def poses(count):
    rng = np.random.default_rng(3)
    return [gtsam.Pose3.Expmap(rng.uniform(-3.0, 3.0, 6)) for _ in range(count)]


def test_numbers_of_many_poses_are_those_of_each_to_the_bit():
    some = [gtsam.Pose3(), *poses(200)]
    assert poses_numbers(some) == [pose_numbers(pose) for pose in some]
    assert poses_numbers([]) == []


def test_data_of_many_factors_are_those_of_each():
    factors = [
        pose_prior(pose_key(0), poses(1)[0], SIGMAS, 5),
        *(
            between_factor(FactorKind.ODOMETRY, (i, i + 1), pose, NOISE, 'left', (i, i + 1))
            for i, pose in enumerate(poses(4))
        ),
        gnss_factor(pose_key(1), np.ones(3), np.eye(3), np.zeros(3), 0.0, 'gnss', 7),
    ]
    assert factors_data(factors) == [factor.data for factor in factors]
    assert factors[1].data['T_first_second'] == pose_numbers(poses(4)[0])
    assert factors[0].data['T_map_base'] == pose_numbers(poses(1)[0])
    assert factors[-1].data['position'] == [1.0, 1.0, 1.0]
