"""Numbers that are none do not get to a topic."""

import numpy as np

from incremental_mapper.results.messages.finite_gate import FiniteGate


def test_message_passes_where_all_its_numbers_are_finite_and_is_told_of_once_where_not():
    told = []
    gate = FiniteGate(told.append)
    assert gate.passes('~/odom', pose=np.eye(4), covariance=None, poses=[[1.0, 2.0]])
    wrong = np.array([1.0, np.nan, -np.inf])
    for _ in range(3):
        assert not gate.passes('~/odom', pose=np.eye(4), velocity=wrong)
    assert not gate.passes('~/map', points=np.full((2, 4), np.nan, np.float32))
    assert gate.passes('~/map', points=np.zeros((0, 4), np.float32))
    assert gate.refused == {'~/odom': 3, '~/map': 1}
    assert len(told) == 2
    assert told[0].startswith('~/odom: not published: 2 of 3 numbers of velocity are not finite')
    assert '8 of 8 numbers of points' in told[1]
