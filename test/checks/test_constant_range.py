"""Beams without a return that are written at one range."""

import numpy as np
import pytest

from incremental_mapper.checks.constant_range import without_constant_ranges


def directions(count: int, elevations: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) of a spinning LiDAR with these rings, radians."""
    azimuth, elevation = (
        grid.ravel()
        for grid in np.meshgrid(
            np.linspace(-np.pi, np.pi, count // len(elevations), endpoint=False), elevations
        )
    )
    return np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=1,
    )


RINGS = np.radians(np.linspace(-15.0, 15.0, 16))
BEAMS = directions(16_000, RINGS)
RANGES = np.random.default_rng(5).uniform(2.0, 60.0, len(BEAMS))


@pytest.mark.parametrize('share', [0.025, 0.05, 0.3, 0.95])
@pytest.mark.parametrize('written', [0.5, 40.0, 131.07])
def test_points_at_one_range_in_many_directions_are_left_out(share, written):
    missed = np.random.default_rng(1).random(len(BEAMS)) < share
    points = BEAMS * np.where(missed, written, RANGES)[:, None]
    kept, remarks = without_constant_ranges(points.astype(np.float32))
    assert np.isnan(kept[missed]).all()
    assert np.isnan(kept[~missed]).mean() < 1e-3
    assert [remark.reason for remark in remarks] == ['constant_range']
    assert f'{written:.3f} m' in remarks[0].text
    assert f'{missed.mean():.0%} of the points' in remarks[0].text


def test_coordinates_in_whole_millimetres_are_at_one_range_as_well():
    missed = np.arange(len(BEAMS)) % 5 == 0
    points = np.round(BEAMS * np.where(missed, 40.0, RANGES)[:, None], 3).astype(np.float32)
    kept, _ = without_constant_ranges(points)
    assert np.isnan(kept[missed, 0]).mean() > 0.95


def test_two_such_ranges_are_both_left_out():
    place = np.arange(len(BEAMS)) % 4
    written = np.choose(place, [40.0, 80.0, RANGES, RANGES])
    kept, remarks = without_constant_ranges((BEAMS * written[:, None]).astype(np.float32))
    assert np.isnan(kept[place < 2]).all() and len(remarks) == 1
    assert '40.000 m' in remarks[0].text and '80.000 m' in remarks[0].text


def test_a_ring_on_level_ground_is_a_surface():
    """Without any noise each ring that looks down sees the ground at one range."""
    ground = np.where(BEAMS[:, 2] < -0.02, 1.8 / np.maximum(-BEAMS[:, 2], 1e-9), RANGES)
    points = (BEAMS * ground[:, None]).astype(np.float32)
    kept, remarks = without_constant_ranges(points)
    assert kept is points and remarks == ()


def test_a_wall_across_is_a_surface():
    """A wall close by, and repeated ranges of a sensor that tells centimetres."""
    wall = np.where(BEAMS[:, 0] > 0.5, 3.0 / np.maximum(BEAMS[:, 0], 1e-9), RANGES)
    points = (BEAMS * np.round(wall, 2)[:, None]).astype(np.float32)
    assert without_constant_ranges(points)[1] == ()


@pytest.mark.parametrize('count', [0, 5, 20])
def test_a_large_cloud_of_few_numbers_is_no_crowd(count):
    points = np.full((5000, 3), np.nan, dtype=np.float32)
    points[:: 5000 // max(count, 1)][:count] = 7.0
    kept, remarks = without_constant_ranges(points)
    assert kept is points and remarks == ()
