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


def test_slivers_of_every_second_cloud_are_no_second_lidar():
    rng = np.random.default_rng(3)
    whole = [sweep(rng) for _ in range(2 * FEWEST_CLOUDS)]
    assert not take_turns([cloud if k % 2 else cloud[:15] + 4.0 for k, cloud in enumerate(whole)])
    assert take_turns([cloud if k % 2 else cloud[:200] + 4.0 for k, cloud in enumerate(whole)])


def rosette(number, rng):
    """A solid-state LiDAR of 70 x 40 degrees in a street, whose loops drift from cloud to cloud."""
    times = number * 0.1 + np.arange(8000) / 80_000
    first, second = 2 * np.pi * 71.3 * times, -2 * np.pi * 66.2 * times
    azimuth = np.radians(35.0) * 0.5 * (np.cos(first) + np.cos(second))
    elevation = np.radians(20.0) * 0.5 * (np.sin(first) + np.sin(second))
    level = np.cos(elevation)
    rays = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    # The road, the houses on both sides and at the end of the street.
    planes = np.array(
        [[0.0, 0.0, -1 / 1.7], [0.0, 1 / 12, 0.0], [0.0, -1 / 9, 0.0], [1 / 60, 0, 0]]
    )
    ranges = 1.0 / (rays @ planes.T).max(axis=1)
    return rays * (ranges + rng.normal(scale=0.02, size=len(ranges)))[:, None]


def test_a_pattern_that_takes_turns_is_one_lidar():
    """Every second cloud of it looks along nearly the same loops."""
    rng = np.random.default_rng(4)
    assert not take_turns([rosette(number, rng) for number in range(24)])


def test_two_turning_lidars_that_see_nearly_the_same_are_two():
    """In open country ranges of both agree, but so do the directions of one with the other's."""
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(0.25, 360.0, 0.5)), np.radians(np.arange(-14.75, -1.0, 2.0))
    )
    rays = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ground = rays * (1.7 / -rays[:, 2:])
    clouds = [ground * (1.0 if number % 2 else 1.05) for number in range(24)]
    assert take_turns(clouds)


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
