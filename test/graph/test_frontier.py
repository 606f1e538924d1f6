"""What a new factor may touch, and what holds a chain of spans where it starts."""

import pytest

from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.graph.frontier import Frontier, chain_start
from incremental_mapper.variables import bias_key, pose_key, velocity_key


@pytest.mark.parametrize(
    ('before', 'kinds'),
    [
        (None, (FactorKind.PRIOR_VELOCITY, FactorKind.PRIOR_BIAS)),
        (899, (FactorKind.PRIOR_VELOCITY, FactorKind.BIAS_RANDOM_WALK)),
        (900, (FactorKind.CONSTANT_VELOCITY, FactorKind.BIAS_RANDOM_WALK)),
        (1000, (FactorKind.CONSTANT_VELOCITY, FactorKind.BIAS_RANDOM_WALK)),
    ],
)
def test_velocity_is_carried_on_over_a_gap_and_no_longer(before, kinds):
    assert chain_start(before, 1000, 100) == kinds


def test_frontier_is_what_chains_head_and_newest_cluster_need():
    assert Frontier().keys() == set() and Frontier().homes() == {}
    frontier = Frontier(
        chains={'left': (3, 30), 'right': (4, 41)}, head=5, inertial=2, newest=6, newest_stamp=60
    )
    poses = {pose_key(number) for number in (3, 4, 5, 6)}
    inertial = {make(number) for number in (2, 5) for make in (velocity_key, bias_key)}
    assert frontier.keys() == poses | inertial
    assert frontier.homes() == {('left', 30): 3, ('right', 41): 4}
