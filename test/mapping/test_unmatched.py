"""Scans with too few points, which nothing connects: no guess holds them in the map."""

import numpy as np

from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import make_scan
from incremental_mapper.settings import make_config

MS = 1_000_000
RNG = np.random.default_rng(3)
WALLS = np.vstack(
    [
        np.column_stack([RNG.uniform(-20, 20, 3000), side, RNG.uniform(0, 4, 3000)])
        for side in (np.full(3000, -8.0), np.full(3000, 9.0))
    ]
    + [np.column_stack([np.full(1500, 20.0), RNG.uniform(-8, 9, 1500), RNG.uniform(0, 4, 1500)])]
)


def scan(number, points=WALLS):
    points = points + RNG.normal(scale=0.005, size=points.shape)  # no LiDAR repeats a cloud
    return make_scan(1_500_000_000_000 * MS + number * 100 * MS, 'left', points)


def test_a_sliver_that_nothing_connects_is_left_out_and_counted():
    mapper = Mapper(make_config({'window': {'max_carry': 0.2}}))
    for number in range(8):
        mapper.push(scan(number, WALLS[::200] if number in (4, 5) else WALLS))
    result = mapper.finish()
    mapper.close()
    stats = result.stats
    assert stats['dropped'] == {'left': {'unmatched': 2}}
    assert stats['clusters'] == 6 and stats['bridges'] == 0 and stats['components'] == 1
