"""The surroundings of a simulated drive: meshes, the ground's shape and the road through them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from incremental_mapper.datasets.simulated.mesh import (
    Height,
    Mesh,
    ground,
    join,
    surface,
    turned,
)
from incremental_mapper.datasets.simulated.options import SceneKind
from incremental_mapper.datasets.simulated.roadside import (
    DEPTH,
    KERB,
    SIDEWALK,
    Frontage,
    houses,
    houses_alike,
    parked_cars,
    straight_frontage,
    street_furniture,
    trees,
)
from incremental_mapper.datasets.simulated.route import Route, bend, polygon_route, winding_route
from incremental_mapper.datasets.simulated.terrain import Terrain, make_terrain

Array = NDArray[np.float64]

HALF_ROAD = 9.0
LANE = 4.5
"""The car keeps so many metres to the right of the middle of the road."""
MARGIN = 110.0
"""Ground beyond the road in metres, more than a LiDAR sees."""
ASPHALT, PAVEMENT, GRASS = 0.15, 0.3, 0.25
# Middles of the roads of the street scene, and the blocks that the car drives around.
STREETS_X = (0.0, 150.0, 260.0)
STREETS_Y = (0.0, 90.0, 180.0)
CORNERS = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))
# A way through the same streets with left turns alone, which the car begins shortly before the
# second corner: after 420 m it drives along a street again, after 780 m it meets another head-on.
REVISITING = (
    (0, 0), (2, 0), (2, 1), (1, 1), (1, 0), (2, 0), (2, 2), (1, 2), (1, 1), (2, 1), (2, 2), (0, 2),
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A place to drive through.

    ``mesh`` is in the world frame (ENU, metres). ``route`` and ``terrain`` are in the scene's
    frame, which is turned by ``yaw`` radians about the vertical: T_world_scene = Rz(yaw).
    """

    mesh: Mesh
    route: Route
    terrain: Terrain
    yaw: float


def make_scene(kind: SceneKind, seed: int) -> Scene:
    """Build a scene; the same seed makes the same one."""
    rng = np.random.default_rng([seed, 1])
    # Away from the axes, so that a wrong yaw cannot pass unnoticed.
    yaw = float(rng.integers(4) * np.pi / 2.0 + rng.uniform(0.3, 1.2))
    builders = {
        SceneKind.STREET: _street,
        SceneKind.CURVE: _curve,
        SceneKind.FIELD: _field,
        SceneKind.REVISIT: _revisit,
        SceneKind.TERRACE: _terrace,
    }
    route, terrain, meshes = builders[kind](rng)
    return Scene(turned(join(meshes), yaw), route, terrain, yaw)


def _street(rng: np.random.Generator) -> tuple[Route, Terrain, list[Mesh]]:
    """A grid of streets; the loop has five left turns and a right turn."""
    return _streets(CORNERS, (11.0, 11.0, 11.0, 8.0, 11.0, 11.0), rng)


def _revisit(rng: np.random.Generator) -> tuple[Route, Terrain, list[Mesh]]:
    """The same grid of streets; the loop passes some of them twice, in either direction."""
    return _streets(REVISITING, (11.0,) * len(REVISITING), rng)


def _streets(
    corners: Sequence[tuple[int, int]], radii: Sequence[float], rng: np.random.Generator
) -> tuple[Route, Terrain, list[Mesh]]:
    """A grid of streets, and a loop over some of its crossings, by their numbers."""
    terrain = make_terrain(0.004, (15.0, 60.0), rng)
    middles = np.array([[STREETS_X[i], STREETS_Y[j]] for i, j in corners])
    route = polygon_route(_outset(middles, LANE), radii)
    low = np.array([STREETS_X[0], STREETS_Y[0]]) - MARGIN
    high = np.array([STREETS_X[-1], STREETS_Y[-1]]) + MARGIN
    meshes = [ground(low, high, 2.0, terrain.height, ASPHALT)]
    columns = [low[0] - HALF_ROAD, *STREETS_X, high[0] + HALF_ROAD]
    rows = [low[1] - HALF_ROAD, *STREETS_Y, high[1] + HALF_ROAD]
    for west, east in itertools.pairwise(columns):
        for south, north in itertools.pairwise(rows):
            corner = np.array([west, south]) + HALF_ROAD
            size = np.array([east - west, north - south]) - 2.0 * HALF_ROAD
            meshes += _block(corner, size, terrain, rng)
    return route, terrain, meshes


def _terrace(rng: np.random.Generator) -> tuple[Route, Terrain, list[Mesh]]:
    """A loop past houses that are all alike, with nothing else to tell one place from another."""
    terrain = make_terrain(0.0, (15.0, 60.0), rng)
    middles = np.array([[0.0, 0.0], [250.0, 0.0], [250.0, 110.0], [0.0, 110.0]])
    route = polygon_route(_outset(middles, LANE), radii=(11.0,) * 4)
    low, high = middles.min(0) - MARGIN, middles.max(0) + MARGIN
    meshes = [ground(low, high, 2.0, terrain.height, ASPHALT)]
    inner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    back = HALF_ROAD + SIDEWALK
    for side in range(4):
        yaw = side * np.pi / 2.0
        start = middles[side] + back * (1.0 - 2.0 * inner[side])
        length = float(np.linalg.norm(middles[(side + 1) % 4] - middles[side])) - 2.0 * back
        meshes += houses_alike(straight_frontage(start, yaw, length), terrain.height)
        # Across the road they look the other way.
        far = middles[(side + 1) % 4] + back * (
            np.array([np.sin(yaw), -np.cos(yaw)]) - np.array([np.cos(yaw), np.sin(yaw)])
        )
        meshes += houses_alike(straight_frontage(far, yaw + np.pi, length), terrain.height)
    return route, terrain, meshes


def _outset(corners: Array, distance: float) -> Array:
    """A counter-clockwise polygon with all its (axis-parallel) sides moved outwards."""
    sides = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([sides[:, 1], -sides[:, 0]], axis=1)
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    moved: Array = corners + distance * (outward + np.roll(outward, 1, axis=0))
    return moved


def _block(corner: Array, size: Array, terrain: Terrain, rng: np.random.Generator) -> list[Mesh]:
    """A block of houses between four kerbs; ``corner`` is its lower left one."""
    height = _raised(terrain)
    meshes = [ground(corner, corner + size, 2.0, height, PAVEMENT)]
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    kerbs = corner + unit * size
    fronts = corner + SIDEWALK + unit * (size - 2.0 * SIDEWALK)
    for side in range(4):
        start, end = kerbs[side], kerbs[(side + 1) % 4]
        length = float(np.linalg.norm(end - start))
        steps = np.linspace(0.0, 1.0, int(length / 2.0) + 1)[:, None]
        meshes.append(_kerb(start + steps * (end - start), height))
        front = straight_frontage(fronts[side], side * np.pi / 2.0, length - 2.0 * SIDEWALK)
        meshes += houses(front, height, _everywhere, rng)
        meshes += parked_cars(front, terrain.height, rng)
        meshes += street_furniture(front, height, rng)
    return meshes


def _curve(rng: np.random.Generator) -> tuple[Route, Terrain, list[Mesh]]:
    """A winding road; kerbs and house fronts follow it."""
    terrain = make_terrain(0.004, (15.0, 60.0), rng)
    route = winding_route(26.0, bend(np.radians(130.0), 28.0), bend(np.radians(-40.0), 30.0), 4)
    arcs = np.arange(0.0, route.length, 1.0)
    path = route.position(arcs)
    meshes = [ground(path.min(0) - MARGIN, path.max(0) + MARGIN, 2.0, terrain.height, ASPHALT)]
    height = _raised(terrain)
    near_road = KDTree(path)

    def free(points: Array) -> NDArray[np.bool_]:
        clear: NDArray[np.bool_] = near_road.query(points)[0] > HALF_ROAD - LANE + 2.0
        return clear

    for front in _frontages_beside(route):
        along = np.arange(0.0, front.length, 1.0)
        rims = [front.place(along, np.full(len(along), inward))[0] for inward in (-SIDEWALK, DEPTH)]
        meshes.append(surface(np.stack([_lifted(rim, height) for rim in rims]), PAVEMENT))
        meshes.append(_kerb(rims[0], height))
        meshes += houses(front, height, free, rng)
        meshes += parked_cars(front, terrain.height, rng)
        meshes += street_furniture(front, height, rng)
    return route, terrain, meshes


def _frontages_beside(route: Route) -> list[Frontage]:
    """The house fronts on the right and on the left of a road."""

    def right(along: Array, inward: Array) -> tuple[Array, Array]:
        # Seen from the houses' side the road runs backwards, so that they are on the left.
        arcs = route.length - along
        yaws = route.heading(arcs) + np.pi
        left = np.stack([-np.sin(yaws), np.cos(yaws)], axis=1)
        distance = HALF_ROAD - LANE + SIDEWALK + inward
        return route.position(arcs) + distance[:, None] * left, yaws

    def left(along: Array, inward: Array) -> tuple[Array, Array]:
        yaws = route.heading(along)
        normals = np.stack([-np.sin(yaws), np.cos(yaws)], axis=1)
        distance = HALF_ROAD + LANE + SIDEWALK + inward
        return route.position(along) + distance[:, None] * normals, yaws

    return [Frontage(route.length, right), Frontage(route.length, left)]


def _field(rng: np.random.Generator) -> tuple[Route, Terrain, list[Mesh]]:
    """Open, uneven country with few trees and nothing rectangular."""
    terrain = make_terrain(0.025, (25.0, 80.0), rng)
    route = winding_route(25.0, bend(np.radians(115.0), 22.0), bend(np.radians(-25.0), 40.0), 4)
    path = route.position(np.arange(0.0, route.length, 1.0))
    low, high = path.min(0) - MARGIN, path.max(0) + MARGIN

    def tufts(points: Array) -> Array:
        return terrain.height(points) + rng.normal(scale=0.03, size=len(points))

    places = rng.uniform(low, high, (260, 2))
    places = places[KDTree(path).query(places)[0] > 5.0]
    meshes = [ground(low, high, 1.2, tufts, GRASS), *trees(places, terrain.height, rng)]
    return route, terrain, meshes


def _raised(terrain: Terrain) -> Height:
    """Height of the pavement behind the kerb."""

    def height(points: Array) -> Array:
        return terrain.height(points) + KERB

    return height


def _lifted(points: Array, height: Height) -> Array:
    return np.column_stack([points, height(points)])


def _kerb(line: Array, height: Height) -> Mesh:
    """The upright face of the kerb below a line of points (N, 2)."""
    top = _lifted(line, height)
    return surface(np.stack([top, top - [0.0, 0.0, 2.0 * KERB]]), PAVEMENT)


def _everywhere(points: Array) -> NDArray[np.bool_]:
    return np.ones(len(points), dtype=np.bool_)
