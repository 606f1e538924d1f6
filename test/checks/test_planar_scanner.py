"""LiDARs whose beams lie in one plane."""

import numpy as np
import pytest

from incremental_mapper.checks.ground import GroundLook
from incremental_mapper.checks.planar_scanner import planar_findings

PLACE = np.array([0.8, 0.2, 1.7])


def look(elevations, span=360.0, tilt=0.0):
    """Five clouds of some beams, degrees, in a street with walls 8 m to both sides."""
    random = np.random.default_rng(3)
    clouds = []
    for _ in range(5):
        azimuth, elevation = np.radians(
            np.meshgrid(random.uniform(-span / 2, span / 2, 400), elevations)
        ).reshape(2, -1)
        level = np.cos(elevation)
        beams = np.column_stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)]
        )
        turn = np.radians(tilt)
        turned = np.array(
            [[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]]
        )
        beams = beams @ turned.T
        planes = np.array([[0, 0, -1 / PLACE[2]], [0, 1 / 8, 0], [0, -1 / 8, 0], [1 / 40, 0, 0]])
        ranges = 1.0 / np.maximum((beams @ planes.T).max(axis=1), 1 / 80)
        noise = random.normal(scale=0.02, size=len(ranges))
        clouds.append((beams * (ranges + noise)[:, None] + PLACE).astype(np.float32))
    return GroundLook('scanner', PLACE, clouds)


@pytest.mark.parametrize('tilt', [0.0, 5.0, 90.0])
@pytest.mark.parametrize('span', [360.0, 270.0])
def test_a_scanner_of_one_plane_is_named(span, tilt):
    (found,) = planar_findings([look([0.0], span, tilt), look([-15.0, -5.0, 5.0, 15.0])])
    assert (found.rule, found.sensor) == ('planar_scanner', 'scanner')


def test_the_lowest_beam_of_a_head_alone_is_one():
    assert planar_findings([look([1.0])])


@pytest.mark.parametrize(
    'elevations', [np.linspace(-15, 15, 16), np.linspace(-24.8, 2.0, 64), [-3.0, -1.0, 1.0, 3.0]]
)
def test_several_beams_are_none(elevations):
    assert planar_findings([look(elevations)]) == []


def test_a_flat_floor_seen_from_above_is_none():
    """Its points lie in a plane, the beams do not."""
    assert planar_findings([look(np.linspace(-15, -5, 6))]) == []


def test_a_few_points_say_nothing():
    one = look([0.0])
    assert planar_findings([GroundLook('few', PLACE, [cloud[:50] for cloud in one.clouds])]) == []
