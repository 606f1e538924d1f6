"""Distance and plane variance of maps: known geometry in, known numbers out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.evaluation.map_quality import (
    PlacedMap,
    compare_maps,
    fit_poses,
    planar_places,
    plane_variance,
)
from incremental_mapper.geometry import transform_points
from incremental_mapper.trajectory import Trajectory, from_matrices

SETTINGS = MomSettings()


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def wall_and_ground(rng, noise=0.0, count=6000):
    """A square of ground, and as large a wall beside and above it: no neighbourhood has both."""
    flat = rng.uniform(-10.0, 10.0, (count, 3))
    flat[: count // 2, 2] = -15.0
    flat[count // 2 :, 1] = 20.0
    return flat + rng.normal(0.0, noise, flat.shape)


def straight(count=40):
    matrices = np.tile(np.eye(4), (count, 1, 1))
    matrices[:, 0, 3] = np.linspace(0.0, 20.0, count)
    return from_matrices(np.arange(count) * 100_000_000, matrices)


def moved(trajectory, transform):
    return from_matrices(trajectory.stamps, transform @ trajectory.matrices())


def some_transform():
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler('zyx', [2.0, 0.05, -0.03]).as_matrix()
    transform[:3, 3] = [300.0, -20.0, 5.0]
    return transform


def test_a_map_is_at_no_distance_from_itself(rng):
    base = PlacedMap(wall_and_ground(rng, 0.02), straight())
    quality = compare_maps(base, base, SETTINGS)
    assert quality.map_distance_m == pytest.approx(0.0, abs=1e-12)
    assert quality.plane_variance_m2 == pytest.approx(0.02**2, rel=0.15)


def test_where_the_frame_of_a_map_lies_does_not_matter(rng):
    base = PlacedMap(wall_and_ground(rng, 0.02), straight())
    transform = some_transform()
    other = PlacedMap(transform_points(transform, base.points), moved(base.trajectory, transform))
    same, quality = compare_maps(base, base, SETTINGS), compare_maps(other, base, SETTINGS)
    assert quality.map_distance_m == pytest.approx(0.0, abs=1e-6)
    assert quality.plane_variance_m2 == pytest.approx(same.plane_variance_m2, rel=1e-6)


def test_a_standing_car_determines_the_frame_too(rng):
    """Its positions are all the same, so only its orientation tells the rotation."""
    matrices = np.tile(np.eye(4), (10, 1, 1))
    standing = from_matrices(np.arange(10) * 100_000_000, matrices)
    transform = some_transform()
    found = fit_poses(moved(standing, transform), standing)
    np.testing.assert_allclose(found, np.linalg.inv(transform), atol=1e-9)


def test_fit_averages_over_noisy_poses_and_other_stamps(rng):
    base = straight(400)
    transform = some_transform()
    noise = np.tile(np.eye(4), (400, 1, 1))
    noise[:, :3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.01, (400, 3))).as_matrix()
    noise[:, :3, 3] = rng.normal(0.0, 0.05, (400, 3))
    own = from_matrices(base.stamps, transform @ base.matrices() @ noise)
    own = Trajectory(own.stamps[1::3] - 30_000_000, own.positions[1::3], own.quaternions[1::3])
    found = fit_poses(own, base) @ transform
    assert np.linalg.norm(Rotation.from_matrix(found[:3, :3]).as_rotvec()) < 0.005


def test_noise_and_double_walls_show(rng):
    base = PlacedMap(wall_and_ground(rng, 0.01), straight())
    noisy = PlacedMap(base.points + rng.normal(0.0, 0.1, base.points.shape), straight())
    second = base.points[base.points[:, 1] > 15.0] + [0.0, 0.4, 0.0]
    double = PlacedMap(np.vstack([base.points, second]), straight())
    of_base, of_noisy, of_double = (
        compare_maps(item, base, SETTINGS) for item in (base, noisy, double)
    )
    assert of_noisy.plane_variance_m2 == pytest.approx(0.01 + 0.01**2, rel=0.2)
    # Half of the places are on the wall, and points half each 0.2 m off their mean.
    assert of_double.plane_variance_m2 == pytest.approx(0.2**2 / 2, rel=0.2)
    assert of_noisy.map_distance_m > 0.03
    assert of_double.map_distance_m == pytest.approx(0.4 / 3, rel=0.3)
    assert of_base.plane_variance_m2 < 2e-4


def test_plane_variance_is_judged_where_the_base_map_is_planar(rng):
    """A map that blurs all planes has none left of its own; the base map's places tell."""
    base = wall_and_ground(rng, 0.01)
    cloud = rng.uniform(-5.0, 5.0, (6000, 3))
    places = planar_places(np.vstack([base, cloud + [100.0, 0.0, 0.0]]), SETTINGS)
    assert len(places) > 0 and (places[:, 0] < 11.0).all()
    blurred = base + rng.normal(0.0, 0.5, base.shape)
    assert plane_variance(blurred, places, SETTINGS) > 0.1


def test_without_a_base_map_there_is_no_distance(rng):
    own = PlacedMap(wall_and_ground(rng, 0.02), straight())
    quality = compare_maps(own, None, SETTINGS)
    assert quality.map_distance_m is None
    assert quality.plane_variance_m2 == compare_maps(own, own, SETTINGS).plane_variance_m2


def test_what_cannot_be_compared_is_none(rng):
    own = PlacedMap(wall_and_ground(rng, 0.02), straight())
    nothing = PlacedMap(np.zeros((0, 3)), straight())
    scattered = PlacedMap(rng.uniform(-1000.0, 1000.0, (200, 3)), straight())
    for pair in ((own, nothing), (nothing, own), (nothing, None)):
        quality = compare_maps(*pair, SETTINGS)
        assert quality.map_distance_m is None and quality.plane_variance_m2 is None
    assert compare_maps(own, scattered, SETTINGS).plane_variance_m2 is None
    assert compare_maps(scattered, own, SETTINGS).map_distance_m > 100.0
