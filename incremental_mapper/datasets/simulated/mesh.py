"""Triangle meshes made of boxes, columns, leaves and height grids.

Coordinates are metres, z up. Every face carries a reflectivity between 0 and 1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Height = Callable[[Array], Array]
"""Ground height (N,) in metres at points (N, 2)."""

# Corners of the unit cube and its faces without the bottom, which no ray from above can see.
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [1, 5, 7], [1, 7, 3]]
)


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """``vertices`` (V, 3) metres, ``faces`` (F, 3) vertex numbers, ``reflectivity`` (F,)."""

    vertices: Array
    faces: NDArray[np.int32]
    reflectivity: Array


def join(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of all ``meshes``."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate(
            [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
        ).astype(np.int32),
        reflectivity=np.concatenate([mesh.reflectivity for mesh in meshes]),
    )


def boxes(centres: Array, sizes: Array, yaws: Array, reflectivity: Array) -> Mesh:
    """Upright boxes: ``centres`` (N, 3) of their bottoms, ``sizes`` (N, 3), ``yaws`` (N,)."""
    return _copies(CUBE, CUBE_FACES, centres, sizes, yaws, reflectivity)


def columns(centres: Array, radii: Array, heights: Array, reflectivity: Array) -> Mesh:
    """Upright ten-sided columns: ``centres`` (N, 3) of their bottoms, ``radii`` (N,)."""
    sides = 10
    angles = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=1)
    prism = np.concatenate([ring, ring + [0.0, 0.0, 1.0]])
    low = np.arange(sides)
    following = (low + 1) % sides
    faces = np.concatenate(
        [
            np.stack([low, following, following + sides], axis=1),
            np.stack([low, following + sides, low + sides], axis=1),
        ]
    )
    sizes = np.stack([radii, radii, heights], axis=1)
    return _copies(prism, faces, centres, sizes, np.zeros(len(radii)), reflectivity)


def leaves(centres: Array, radii: Array, count: int, rng: np.random.Generator) -> Mesh:
    """Tree crowns: ``count`` random triangles in a ball of ``radii`` (N,) at ``centres`` (N, 3)."""
    total = len(centres) * count
    direction = rng.normal(size=(total, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    distance = np.repeat(radii, count) * rng.uniform(0.2, 1.0, total) ** (1.0 / 3.0)
    middle = np.repeat(centres, count, axis=0) + direction * distance[:, None]
    corners = middle[:, None, :] + rng.normal(scale=0.18, size=(total, 3, 3))
    return Mesh(
        vertices=corners.reshape(-1, 3),
        faces=np.arange(3 * total, dtype=np.int32).reshape(-1, 3),
        reflectivity=np.full(total, 0.25),
    )


def surface(points: Array, reflectivity: float) -> Mesh:
    """A sheet through a grid of points (A, B, 3), A and B at least 2."""
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )
    return Mesh(
        vertices=points.reshape(-1, 3),
        faces=faces.astype(np.int32),
        reflectivity=np.full(len(faces), reflectivity),
    )


def ground(low: Array, high: Array, cell: float, height: Height, reflectivity: float) -> Mesh:
    """A height grid over the rectangle from ``low`` (2,) to ``high`` (2,)."""
    counts = np.maximum(np.ceil((high - low) / cell).astype(np.int64), 1) + 1
    x, y = np.meshgrid(
        np.linspace(low[0], high[0], counts[0]),
        np.linspace(low[1], high[1], counts[1]),
        indexing='ij',
    )
    z = height(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape)
    return surface(np.stack([x, y, z], axis=-1), reflectivity)


def turned(mesh: Mesh, yaw: float) -> Mesh:
    """The mesh turned by ``yaw`` radians about the z axis."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Mesh(mesh.vertices @ rotation.T, mesh.faces, mesh.reflectivity)


def _copies(
    shape: Array,
    faces: NDArray[np.int64],
    centres: Array,
    sizes: Array,
    yaws: Array,
    reflectivity: Array,
) -> Mesh:
    local = shape[None] * sizes[:, None, :]
    cos, sin = np.cos(yaws)[:, None], np.sin(yaws)[:, None]
    x = cos * local[..., 0] - sin * local[..., 1]
    y = sin * local[..., 0] + cos * local[..., 1]
    vertices = np.stack([x, y, local[..., 2]], axis=-1) + centres[:, None, :]
    numbers = faces[None] + (np.arange(len(centres)) * len(shape))[:, None, None]
    return Mesh(
        vertices=vertices.reshape(-1, 3),
        faces=numbers.reshape(-1, 3).astype(np.int32),
        reflectivity=np.repeat(reflectivity, len(faces)),
    )
