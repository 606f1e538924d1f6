"""Two LiDARs that take turns on one topic, and clouds of which most are broken."""

import numpy as np

from incremental_mapper.checks.sweeps import FEWEST_CLOUDS, take_turns


def sweep(rng, tilt=0.0):
    angles = rng.uniform(0.0, 2 * np.pi, 400)
    ranges = rng.uniform(4.0, 30.0, 400)
    height = rng.uniform(-1.5, 3.0, 400) + tilt * ranges * np.cos(angles)
    return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles), height])


def test_two_lidars_take_turns_even_where_a_cloud_is_lost():
    rng = np.random.default_rng(1)
    for lost in (None, 2, 5, 9):
        clouds = [sweep(rng) + (0.0 if k % 2 else 5.0) for k in range(FEWEST_CLOUDS + 1)]
        del clouds[lost if lost is not None else -1]
        assert take_turns(clouds)


def test_one_lidar_does_not():
    rng = np.random.default_rng(2)
    assert not take_turns([sweep(rng) for _ in range(FEWEST_CLOUDS)])


def test_broken_clouds_among_sound_ones_are_no_second_lidar():
    """Whatever is wrong with them: the medians alone took one stretch in ten for two LiDARs."""
    rng = np.random.default_rng(3)
    taken = 0
    for _ in range(400):
        broken = rng.random(FEWEST_CLOUDS) < 0.5
        clouds = [
            rng.normal(0.0, 10.0 ** rng.uniform(-1.0, 4.0), (20, 3)) if bad else sweep(rng)
            for bad in broken
        ]
        taken += take_turns(clouds)
    assert taken <= 4
