"""Stamps that stand still and leap, held against the times of recording."""

import numpy as np
import pytest

from incremental_mapper.checks.coarse_stamps import is_coarse

SECOND = 10**9
RECORDED = 1_700_000_000 * SECOND + 123_000_000 + np.arange(40) * SECOND // 10


def micro(stamps):
    return stamps // SECOND * SECOND + stamps % SECOND // 1000


@pytest.mark.parametrize(
    'stamps',
    [RECORDED // SECOND * SECOND, micro(RECORDED), RECORDED // (SECOND // 2) * SECOND // 2],
)
def test_stamps_that_stand_are_found(stamps):
    assert is_coarse(np.column_stack([RECORDED, stamps]))


def test_sound_ones_are_not():
    noise = np.random.default_rng(0).integers(0, SECOND // 20, 40)
    assert not is_coarse(np.column_stack([RECORDED, RECORDED - noise]))
    # Every message twice.
    twice = np.sort(np.concatenate([RECORDED, RECORDED + 1_000_000]))
    assert not is_coarse(np.column_stack([twice, np.repeat(RECORDED, 2)]))
    # Waited in a queue, and came twenty at a time.
    waited = RECORDED[np.arange(40) // 20 * 20] + np.arange(40) * 10_000
    assert not is_coarse(np.column_stack([waited, RECORDED]))
