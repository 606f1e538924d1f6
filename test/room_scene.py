"""Rooms of three walls as local maps: scans, their poses, and candidates that move them."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.config import MomSettings
from incremental_mapper.scoring.mom import (
    LocalMap,
)

SETTINGS = MomSettings()

ORIGIN = np.array([300.0, -200.0, 20.0])


def wall(rng, axis, count=900, noise=0.02, size=10.0):
    """Points on a plane across ``axis`` that ends well before it meets the other planes."""
    points = rng.uniform(3.0, 3.0 + size, size=(count, 3))
    points[:, axis] = rng.normal(scale=noise, size=count)
    return points


def room(rng, axes=(0, 1, 2)):
    return np.vstack([wall(rng, axis) for axis in axes])


def lattice_room(rng):
    """Walls with points every 0.4 m, uneven by up to 2 cm.

    Within a wall no two points are 1.45 to 1.59 m apart, so that neighbourhoods of 1.5 m do not
    change when scans are moved by a few centimetres.
    """
    steps = 3.0 + 0.4 * np.arange(26)
    walls = []
    for axis in range(3):
        one, other = (grid.ravel() for grid in np.meshgrid(steps, steps))
        across = rng.uniform(-0.02, 0.02, size=len(one))
        walls.append(np.roll(np.stack([across, one, other], axis=1), axis, axis=1))
    return np.vstack(walls)


def pose(translation=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0)):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    matrix[:3, 3] = np.asarray(translation) + ORIGIN
    return matrix


def make_scene(clouds, poses, fresh=1, fixed=None):
    """Scans given in the room's frame, seen from their poses; the room stands at ORIGIN."""
    moving = [
        (cloud + ORIGIN - matrix[:3, 3]) @ matrix[:3, :3]
        for cloud, matrix in zip(clouds, poses, strict=True)
    ]
    known = np.zeros((0, 3)) if fixed is None else fixed + ORIGIN
    return LocalMap(known, moving, np.array(poses)[None], fresh, ORIGIN)


@cache
def room_scene(seed=0, axes=(0, 1, 2)):
    rng = np.random.default_rng(seed)
    poses = [pose((4, 5, 1), (0.02, -0.01, 0.6)), pose((3.5, 5, 1), (0, 0, 0.5)), pose((3, 5, 1))]
    return make_scene([room(rng, axes) for _ in poses], poses, 2, room(rng, axes))


def moved(local_map, translation=(0, 0, 0), rotation=(0, 0, 0), which=0):
    """The local_map's poses with one scan shifted and turned a little in the map."""
    poses = local_map.poses[0].copy()
    poses[which, :3, :3] = Rotation.from_rotvec(rotation).as_matrix() @ poses[which, :3, :3]
    poses[which, :3, 3] += translation
    return poses


def with_candidates(local_map, *candidates):
    return replace(local_map, poses=np.stack([local_map.poses[0], *candidates]))


def jittered(local_map, count, metres, radians, seed=0):
    """The local_map with candidates that move all of its scans at random."""
    rng = np.random.default_rng(seed)
    candidates = []
    for _ in range(count):
        poses = local_map.poses[0].copy()
        for one in poses:
            turn = Rotation.from_rotvec(rng.normal(scale=radians, size=3)).as_matrix()
            one[:3, :3] = turn @ one[:3, :3]
            one[:3, 3] += rng.normal(scale=metres, size=3)
        candidates.append(poses)
    return with_candidates(local_map, *candidates)


def score_by_brute_force(query_points, poses, local_map):
    """The definition, written without anything of the package but where the query_points are."""
    clouds = [local_map.fixed]
    motions = [np.eye(4)]
    for before, after, cloud in zip(local_map.poses[0], poses, local_map.moving, strict=True):
        clouds.append(cloud @ after[:3, :3].T + after[:3, 3])
        motions.append(after @ np.linalg.inv(before))
    points = np.vstack(clouds)
    variances = []
    for point, scan in zip(query_points.points, query_points.scan, strict=True):
        place = (motions[scan] @ np.append(point + local_map.origin, 1.0))[:3]
        near = points[np.linalg.norm(points - place, axis=1) <= SETTINGS.radius]
        variances.append(np.linalg.eigvalsh(np.cov(near.T, bias=True))[0])
    variances = np.array(variances)
    return np.mean(
        [variances[query_points.family == family].mean() for family in query_points.families]
    )
