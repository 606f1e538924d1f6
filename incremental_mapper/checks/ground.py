"""Where the ground is by each LiDAR's clouds in base_link: level, and below the LiDAR.

Wrong roll, pitch and height of a LiDAR show nowhere else. They turn neither its forward motion nor
the graph, only its points, so that the map of two LiDARs is double, or upside down.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity

NEAR = 20.0
"""Metres around base_link in which ground is looked for; roads bend further away."""
SAMPLE, MORE = 400, 3
"""Points near by that are looked at, and how many times as many are taken to find them."""
TRIES = 50
"""Planes that are tried; with half of the points on the ground all but one in 800 looks find it."""
THICK = 0.15
"""Metres from a plane within which points lie on it."""
FEWEST = 100
"""Points near by that tell something."""
CLOUDS = 3
"""Clouds that make a judgement."""
SHARE = 0.35
"""Least share of the near points on the ground. Simulated streets: 0.45 to 0.77."""
MOST = 0.8
"""Share of the clouds that must say the same."""
LEVEL = 20.0
"""Degrees from z within which a plane may be the ground."""
WALL = 60.0
"""Degrees from z beyond which it is a wall."""
TILTED = 4.0
"""Degrees between ground and base_link of which a user is told. Sound runs: 0 to 1. Pitched by 5
degrees a map leans by 3 and is 0.06 m off after 25 s, where it was 0.017."""
DIFFERENT, DOUBLE = 4.0, 8.0
"""Degrees between the grounds of two LiDARs of which a user is told, and that make the map double.
Sound runs: 1.2 at the most."""
STEP, DEEP = 0.4, 1.0
"""Metres between the heights of the two; as above. Sound runs: 0.04 at the most."""
FLOOR = 0.1
"""Share of the points in one level layer below a LiDAR that hangs upside down, at most: walls have
0.05, and a floor below a ceiling has more."""
ON_OTHER = 0.1
"""Share of a LiDAR's points on the ground of another's, at most, where its own largest plane is a
wall. Turned by 45 or 90 degrees: 0.02 to 0.05; sound runs: 0.55 and more."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundLook:
    """Some clouds of one LiDAR, spread over the drive.

    Attributes:
        sensor: Name of the LiDAR.
        place: Of the LiDAR in base_link (3,), metres.
        clouds: Points (N, 3) of each in base_link, metres.
    """

    sensor: str
    place: NDArray[np.float64]
    clouds: Sequence[NDArray[np.floating]]

    @property
    def height(self) -> float:
        """Z of the LiDAR in base_link, metres."""
        return float(self.place[2])


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """What one LiDAR's clouds say: the medians of their largest planes, and their near points.

    ``normal`` (3,) and ``offset``, metres, are the plane's; ``degrees`` is between normal and z;
    ``floor`` is the share of points in the fullest level layer below the LiDAR.
    """

    sensor: str
    lidar_height: float
    normal: NDArray[np.float64]
    offset: float
    degrees: float
    floor: float
    points: NDArray[np.float64]

    @property
    def height(self) -> float:
        """Where a level plane passes base_link, metres."""
        return self.offset / float(self.normal[2])

    @property
    def level(self) -> bool:
        """Whether the plane may be the ground."""
        return self.degrees < LEVEL


def ground_findings(looks: Sequence[GroundLook]) -> list[Finding]:
    """Say which LiDARs see the ground where none can be.

    Args:
        looks: Clouds of each LiDAR.

    Returns:
        ``upside_down``, ``grounds_differ`` or ``ground_tilted``, the first that holds.
    """
    grounds = [ground for look in looks if (ground := see_ground(look)) is not None]
    over = [item for item in grounds if _is_above(item)]
    if over:
        # One alone may look at a ceiling.
        severity = Severity.ERROR if len(over) == len(looks) else Severity.WARNING
        return [_upside_down(item, severity) for item in over]
    different = [
        finding
        for one, other in combinations(grounds, 2)
        if (finding := _compare(one, other)) is not None
    ]
    if different:
        return different
    return [_tilted(item) for item in grounds if TILTED < item.degrees < WALL]


def see_ground(look: GroundLook) -> Ground | None:
    """The largest plane of a LiDAR's clouds, where most of them show the same one.

    Args:
        look: Some clouds.

    Returns:
        What they say together; None where they say nothing.
    """
    random = np.random.default_rng(0)  # the same findings in every run
    near = [_near(cloud, random) for cloud in look.clouds]
    planes = [_largest_plane(points, random) for points in near if len(points) >= FEWEST]
    seen = [plane for plane in planes if plane is not None]
    if len(seen) < max(CLOUDS, MOST * len(look.clouds)):
        return None
    normals, offsets = np.array([one for one, _ in seen]), np.array([far for _, far in seen])
    normal = np.median(normals, axis=0)
    normal /= np.linalg.norm(normal)
    same = normals @ normal > np.cos(np.radians(TILTED / 2.0))
    offset = float(np.median(offsets))
    same &= np.abs(offsets - offset) < STEP
    if same.mean() < MOST:
        return None
    points = np.vstack(near)
    return Ground(
        sensor=look.sensor,
        lidar_height=look.height,
        normal=normal,
        offset=offset,
        degrees=float(np.degrees(np.arccos(min(abs(normal[2]), 1.0)))),
        floor=_fullest_layer(points[:, 2] - look.height),
        points=points,
    )


def _near(cloud: NDArray[np.floating], random: np.random.Generator) -> NDArray[np.float64]:
    """Some of the points near the vehicle (M, 3)."""
    chosen = cloud
    if len(cloud) > MORE * SAMPLE:  # most points of a cloud are near by
        chosen = cloud[random.integers(0, len(cloud), MORE * SAMPLE)]
    points = chosen[np.hypot(chosen[:, 0], chosen[:, 1]) < NEAR]
    return np.asarray(points[:: len(points) // SAMPLE + 1], dtype=np.float64)


def _largest_plane(
    points: NDArray[np.float64], random: np.random.Generator
) -> tuple[NDArray[np.float64], float] | None:
    """Normal (3,) and offset, metres, of the plane with most points; None where it has few."""
    corners = points[random.integers(0, len(points), (TRIES, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    wide = areas > 1.0  # square metres; small triangles tell no direction
    if not wide.any():
        return None
    normals = normals[wide] / areas[wide, None]
    offsets = (normals * corners[wide, 0]).sum(axis=1)
    best = int((np.abs(points @ normals.T - offsets) < THICK).sum(axis=0).argmax())
    on = points[np.abs(points @ normals[best] - offsets[best]) < THICK]
    if len(on) < SHARE * len(points):
        return None
    centre = on.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov((on - centre).T))
    normal = vectors[:, 0] * np.copysign(1.0, vectors[np.abs(vectors[:, 0]).argmax(), 0])
    return normal, float(normal @ centre)


def _fullest_layer(heights: NDArray[np.float64]) -> float:
    """Share of the points in the fullest level layer below the LiDAR; ``heights`` (M,) over it."""
    layers = (-heights[heights < -2.0 * THICK] / (2.0 * THICK)).astype(int)
    return float(np.bincount(layers).max() / len(heights)) if len(layers) else 0.0


def _is_above(item: Ground) -> bool:
    if not item.level or item.floor >= FLOOR:
        return False
    return item.height > item.lidar_height + 2.0 * THICK


def _upside_down(item: Ground, severity: Severity) -> Finding:
    return Finding(
        'upside_down',
        severity,
        item.sensor,
        f'its ground lies {item.height - item.lidar_height:.1f} m above it, and nothing below: '
        'its points are upside down',
        f'turn lidars.{item.sensor}.T_base_sensor by 180 degrees about x or y (z is up)',
    )


def _tilted(item: Ground) -> Finding:
    return Finding(
        'ground_tilted',
        Severity.WARNING,
        item.sensor,
        f'the ground under it is tilted by {item.degrees:.0f} degrees in base_link',
        f'check roll and pitch of lidars.{item.sensor}.T_base_sensor',
    )


def _compare(one: Ground, other: Ground) -> Finding | None:
    """Hold the grounds of two LiDARs against each other."""
    if one.level != other.level:
        return _without_ground(*((one, other) if other.level else (other, one)))
    if not one.level or max(one.height - one.lidar_height, other.height - other.lidar_height) > 0:
        return None  # walls, or a ceiling, tell nothing
    degrees = float(np.degrees(np.arccos(min(float(one.normal @ other.normal), 1.0))))
    step = abs(one.height - other.height)
    if degrees < DIFFERENT and step < STEP:
        return None
    tilts = {item.sensor: item.degrees for item in (one, other)}
    suspect = max(tilts, key=lambda name: tilts[name])
    named = tilts[suspect] > 2.0 * min(tilts.values()) + DIFFERENT / 2.0
    sensor = suspect if named else f'{one.sensor}, {other.sensor}'
    return Finding(
        'grounds_differ',
        Severity.ERROR if degrees > DOUBLE or step > DEEP else Severity.WARNING,
        sensor,
        f'{one.sensor} and {other.sensor} see the ground {degrees:.0f} degrees and {step:.1f} m '
        'apart: the map is double',
        'check roll, pitch and height in '
        + ' and '.join(f'lidars.{name}.T_base_sensor' for name in sensor.split(', ')),
    )


def _without_ground(item: Ground, other: Ground) -> Finding | None:
    """A LiDAR whose largest plane is no ground, beside one that has one."""
    distance = item.points @ other.normal - other.offset
    if np.mean(np.abs(distance) < 2.0 * THICK) > ON_OTHER:
        return None
    return Finding(
        'grounds_differ',
        Severity.WARNING,  # it may look at a wall and over the ground
        item.sensor,
        f'next to none of its points lie on the ground that {other.sensor} sees; its largest plane '
        f'is turned by {item.degrees:.0f} degrees',
        f'check roll and pitch of lidars.{item.sensor}.T_base_sensor',
    )
