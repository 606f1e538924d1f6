"""Chains of IMU spans that start anew: what is known of velocity and bias goes on."""

import numpy as np
import pymap3d
import pytest

from incremental_mapper.config import Strategy
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan
from incremental_mapper.settings import make_config
from incremental_mapper.variables import bias_key, velocity_key

MS = 1_000_000
SECOND = 1000 * MS
START = 1_000 * SECOND
SPEED = 1.5
BIAS = np.array([0.05, 0.0, 0.0])
"""m/s^2 that the accelerometer reads too much."""


def walls(east, seed=0):
    """Ground and two walls, seen by a car that has driven ``east`` metres."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-20.0, 20.0, size=(3, 200, 3))
    points[:, :, 2] = rng.uniform(-2.0, 10.0, size=(3, 200))
    for axis, place in enumerate((-15.0, -12.0, -2.0)):
        points[axis, :, axis] = place
    return (points.reshape(-1, 3) - [east, 0.0, 0.0]).astype(np.float32)


def driven(seconds, fix_after, strategy=Strategy.BASE, hole=()):
    """A mapper that has seen a steady drive with a fix every 0.5 s, ``fix_after`` ms after a scan.

    Scans come 3 ms after an IMU sample, so 4 ms later there is none in between. ``hole`` are
    seconds without samples.
    """
    config = make_config(
        {
            'selection': {'strategy': strategy},
            'lidars': {'names': ['left']},
            'odometry': {'sigma_translation': 0.05},
            'graph': {'final_optimization': False},
        }
    )
    items = [
        ImuSample(START + i * 10 * MS, 'imu', np.zeros(3), BIAS + [0.0, 0.0, 9.81])
        for i in range(round(seconds * 100))
        if not (hole and hole[0] < i / 100 < hole[1])
    ]
    for i in range(round(seconds * 10)):
        stamp = START + (i * 100 + 3) * MS
        items.append(LidarScan(stamp, 'left', walls(SPEED * i / 10)))
        if i % 5 == 2:
            east = SPEED * (i / 10 + fix_after / 1000)
            place = pymap3d.enu2geodetic(east, 0.0, 0.0, 36.5, 127.25, 50.0)
            fix = (*map(float, place), FixStatus.GBAS, np.eye(3) * 0.05**2)
            items.append(GnssFix(stamp + fix_after * MS, 'gps', *fix))
    mapper = Mapper(config, ['left', 'gps', 'imu'])
    for item in sorted(items, key=lambda item: item.stamp):
        mapper.push(item)
    mapper.flush()
    return mapper


def sigma(mapper, make_key):
    frontier = mapper.state.frontier
    covariance = mapper.state.prior.covariance(make_key(frontier.inertial))
    return np.sqrt(np.linalg.eigvalsh(covariance)[-1])


def kinds(mapper):
    return {kind: count for kind, count in mapper.state.factor_counts.items() if count}


def test_a_chain_that_starts_anew_knows_as_much_as_one_that_went_on():
    broken, whole = driven(12.0, fix_after=4), driven(12.0, fix_after=50)
    assert FactorKind.BIAS_RANDOM_WALK not in kinds(whole)
    assert kinds(broken)[FactorKind.BIAS_RANDOM_WALK] > 10
    assert kinds(broken)[FactorKind.CONSTANT_VELOCITY] > 10
    for counts in (kinds(broken), kinds(whole)):
        assert counts[FactorKind.PRIOR_VELOCITY] == counts[FactorKind.PRIOR_BIAS] == 1
    assert sigma(broken, bias_key) < 1.2 * sigma(whole, bias_key)
    # The pose that a chain starts at is its own, so a part of what was known is lost in any case.
    assert sigma(broken, velocity_key) < 3.0 * sigma(whole, velocity_key)
    head = broken.state.frontier.inertial
    assert broken.state.velocity(head) == pytest.approx([SPEED, 0.0, 0.0], abs=0.1)


def test_a_hole_lets_the_velocity_go_but_not_the_bias():
    mapper = driven(6.0, fix_after=50, hole=(3.0, 3.6))
    counts = kinds(mapper)
    assert counts[FactorKind.PRIOR_VELOCITY] == 2
    assert counts[FactorKind.PRIOR_BIAS] == counts[FactorKind.BIAS_RANDOM_WALK] == 1
    assert FactorKind.CONSTANT_VELOCITY not in counts


def test_continuity_connects_nothing():
    # A fix apart from all samples stays apart, whatever is known of its velocity.
    mapper = driven(6.0, fix_after=4, hole=(3.0, 3.6))
    joined = {key for factor in mapper.state.factors for key in factor.keys}
    assert len(joined) == mapper.stats()['vertices']
    alone = driven(1.2, fix_after=4, hole=(0.0, 1.2))
    assert alone.stats()['components'] == 3


@pytest.mark.parametrize('strategy', [Strategy.MOM, Strategy.MIN_TIME_SHIFT])
def test_every_strategy_carries_velocity_and_bias_over(strategy):
    mapper = driven(8.0, fix_after=4, strategy=strategy)
    counts = kinds(mapper)
    assert counts[FactorKind.PRIOR_VELOCITY] == counts[FactorKind.PRIOR_BIAS] == 1
    assert mapper.stats()['components'] == 1
    head = mapper.state.frontier.inertial
    assert mapper.state.velocity(head) == pytest.approx([SPEED, 0.0, 0.0], abs=0.2)
