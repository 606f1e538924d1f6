"""What stands beside a road: rows of houses, parked cars, lamp posts and trees.

Everything is placed along a frontage, the line of the house fronts: ``along`` it in metres, and
``inward``, to its left and away from the road, in metres.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated.mesh import Height, Mesh, boxes, columns, leaves

Array = NDArray[np.float64]

SIDEWALK = 4.0
KERB = 0.15
DEPTH = 10.0
FLOOR = 3.5


@dataclass(frozen=True, slots=True)
class Frontage:
    """A line of house fronts of ``length`` metres.

    ``place(along, inward)`` gives points (N, 2) and the line's headings (N,) there.
    """

    length: float
    place: Callable[[Array, Array], tuple[Array, Array]]


def straight_frontage(start: Array, yaw: float, length: float) -> Frontage:
    """A frontage from ``start`` (2,) in the direction ``yaw``."""
    forward = np.array([np.cos(yaw), np.sin(yaw)])
    left = np.array([-forward[1], forward[0]])

    def place(along: Array, inward: Array) -> tuple[Array, Array]:
        points = start + along[:, None] * forward + inward[:, None] * left
        return points, np.full(len(along), yaw)

    return Frontage(length, place)


def houses(
    frontage: Frontage,
    height: Height,
    free: Callable[[Array], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> list[Mesh]:
    """A row of houses with set-backs, gaps, pilasters, ledges and porches.

    ``free`` says which points (N, 2) may be built on; houses that need others are left out.
    """
    meshes: list[Mesh] = []
    along = rng.uniform(0.0, 2.0)
    while along + 6.0 < frontage.length:
        width = min(rng.uniform(8.0, 18.0), frontage.length - along)
        setback = 0.0 if rng.random() < 0.5 else rng.uniform(0.4, 2.0)
        parts = _house_parts(width, FLOOR * rng.integers(2, 5), rng)
        middle, yaw = frontage.place(np.array([along + width / 2.0]), np.array([setback]))
        along += width + (0.0 if rng.random() < 0.4 else rng.uniform(1.5, 6.0))
        forward = np.array([np.cos(yaw[0]), np.sin(yaw[0])])
        left = np.array([-forward[1], forward[0]])
        across = np.linspace(-width / 2.0, width / 2.0, 7)[:, None] * forward
        if not free(np.concatenate([middle + across, middle + across + DEPTH * left])).all():
            continue
        points = middle + parts[:, :1] * forward + parts[:, 1:2] * left
        # Half a metre of every house is below the ground, which may slope.
        z = height(middle)[0] - 0.5 + parts[:, 2]
        meshes.append(
            boxes(
                np.column_stack([points, z]),
                parts[:, 3:],
                np.full(len(parts), yaw[0]),
                np.full(len(parts), rng.uniform(0.2, 0.6)),
            )
        )
    return meshes


def houses_alike(frontage: Frontage, height: Height) -> list[Mesh]:
    """A row of houses of which one is like the other."""
    width = 10.0
    parts = _house_parts(width, 2.0 * FLOOR, np.random.default_rng(0))
    along = np.arange(width / 2.0, frontage.length - width / 2.0, width + 2.0)
    middles, yaws = frontage.place(along, np.zeros(len(along)))
    meshes: list[Mesh] = []
    for middle, yaw in zip(middles, yaws.tolist(), strict=True):
        forward = np.array([np.cos(yaw), np.sin(yaw)])
        left = np.array([-forward[1], forward[0]])
        points = middle + parts[:, :1] * forward + parts[:, 1:2] * left
        z = height(middle[None])[0] - 0.5 + parts[:, 2]
        turns, paint = np.full(len(parts), yaw), np.full(len(parts), 0.4)
        meshes.append(boxes(np.column_stack([points, z]), parts[:, 3:], turns, paint))
    return meshes


def _house_parts(width: float, tall: float, rng: np.random.Generator) -> Array:
    """Boxes of one house (P, 6): middle of the bottom (along, inward, up) and size, in metres.

    The middle of the front is the origin; parts in front of it have negative inward values.
    """
    parts = [[0.0, DEPTH / 2.0, 0.0, width, DEPTH, tall]]
    bays = max(int(width / rng.uniform(3.0, 5.0)), 1)
    thick = rng.uniform(0.2, 0.5)
    for x in np.linspace(-width / 2.0 + 0.25, width / 2.0 - 0.25, bays + 1):
        parts.append([float(x), -thick / 2.0, 0.0, 0.5, thick, tall])
    for floor in range(1, round(tall / FLOOR) + 1):
        parts.append([0.0, -0.3, FLOOR * floor + 0.2, width, 0.6, 0.3])
    porch = rng.uniform(-width / 2.0 + 2.0, width / 2.0 - 2.0)
    parts.append([float(porch), -0.6, 0.0, 3.0, 1.2, 3.3])
    return np.array(parts)


def parked_cars(frontage: Frontage, height: Height, rng: np.random.Generator) -> list[Mesh]:
    """Cars along the kerb, none near the ends of the frontage where roads may cross."""
    slots = np.arange(18.0, frontage.length - 18.0, 6.5)
    slots = slots[rng.random(len(slots)) < 0.6]
    count = len(slots)
    if count == 0:
        return []
    inward = -SIDEWALK - 1.05 + rng.normal(scale=0.05, size=count)
    points, yaws = frontage.place(slots + rng.uniform(-0.7, 0.7, count), inward)
    yaws = yaws + rng.normal(scale=0.02, size=count)
    z = height(points)
    scale = rng.uniform(0.9, 1.1, (count, 1))
    paint = rng.uniform(0.15, 0.8, count)
    cabin = points - 0.3 * np.stack([np.cos(yaws), np.sin(yaws)], axis=1)
    return [
        boxes(np.column_stack([points, z + 0.2]), scale * [4.4, 1.8, 0.75], yaws, paint),
        boxes(np.column_stack([cabin, z + 0.8]), scale * [2.4, 1.6, 0.65], yaws, paint),
    ]


def street_furniture(frontage: Frontage, height: Height, rng: np.random.Generator) -> list[Mesh]:
    """Lamp posts and trees on the sidewalk, behind the kerb."""
    posts = np.arange(6.0, frontage.length - 5.0, 24.0)
    if len(posts) == 0:
        return []
    posts_at, _ = frontage.place(posts, np.full(len(posts), 0.6 - SIDEWALK))
    trunks = posts[:-1] + 12.0 + rng.uniform(-2.0, 2.0, len(posts) - 1)
    trunks_at, _ = frontage.place(trunks, np.full(len(trunks), 0.9 - SIDEWALK))
    count = len(posts)
    lamps = columns(
        np.column_stack([posts_at, height(posts_at)]),
        np.full(count, 0.12),
        rng.uniform(6.0, 8.0, count),
        np.full(count, 0.5),
    )
    return [lamps, *trees(trunks_at, height, rng)]


def trees(places: Array, height: Height, rng: np.random.Generator) -> list[Mesh]:
    """A tree at each of ``places`` (N, 2): a trunk and a crown of leaves."""
    count = len(places)
    if count == 0:
        return []
    base = np.column_stack([places, height(places) - 0.2])
    tall = rng.uniform(2.5, 4.0, count)
    crown = rng.uniform(1.2, 2.2, count)
    trunk = columns(base, rng.uniform(0.1, 0.25, count), tall, np.full(count, 0.3))
    above = base + np.column_stack([np.zeros((count, 2)), tall + 0.6 * crown])
    return [trunk, leaves(above, crown, 120, rng)]
