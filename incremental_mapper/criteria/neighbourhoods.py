"""Which points lie around a query, and the moments that they have there.

Every window asks once, and of points that stand elsewhere in the next window, so that building a
tree does not pay. The points are sorted into cubes instead, by counting. The cubes are numbered
periodically along each axis: points that are far from each other may share one, which costs a
look at them, but however far the points spread there are about as many cubes as points.
"""

from dataclasses import dataclass
from math import floor, sqrt

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

MOST = 1e15
"""Numbers of cubes count exactly up to here; no point is further out."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Points sorted into cubes of ``width`` metres.

    ``points`` (N, 3) in metres and their ``scan`` (N,) lie in the order of the cubes, those that
    are not finite left out. Cube i has the points ``starts[i]`` to ``starts[i + 1]``;
    ``masks`` (3,) are the numbers of cubes along the axes less one, each a power of two less one.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int64]
    starts: NDArray[np.int64]
    masks: NDArray[np.int64]
    width: float


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """Pairs of a query and a point near the rim of its ball, sorted by query and scan.

    Query q and the points of scan s have the pairs ``starts[q, s]`` to ``starts[q, s + 1]``;
    ``starts`` is (Q, S + 1). ``apart`` (N, 3) is point minus query and ``inside`` (N,) whether it
    is within the radius.
    """

    starts: NDArray[np.int64]
    apart: NDArray[np.float64]
    inside: NDArray[np.bool_]


def make_grid(points: NDArray[np.float64], bounds: NDArray[np.int64], width: float) -> Grid:
    """Sort ``points`` (N, 3), of which scan s has bounds[s] to bounds[s + 1], ``bounds`` (S + 1,).

    ``width`` in metres is about the radius of the later searches.
    """
    bits = max(len(points).bit_length(), 6)
    # The world is flat: fewer cubes are stacked than lie side by side.
    up = bits // 4
    across = (bits - up) // 2
    masks = np.array([1 << (bits - up - across), 1 << across, 1 << up]) - 1
    return Grid(*_sort(points, bounds, width, masks), masks, width)


def moments_of_parts(
    grid: Grid, queries: NDArray[np.float64], radius: float, scans: int
) -> NDArray[np.float64]:
    """Moments (Q, S, 10) of each scan's points within ``radius`` of ``queries`` (Q, 3).

    About the query, whose points are near and so keep the moments exact.
    """
    return _moments(
        grid.points, grid.scan, grid.starts, grid.masks, grid.width, queries, radius, scans
    )


def find_rim(
    grid: Grid, queries: NDArray[np.float64], radius: float, reach: NDArray[np.float64]
) -> Rim:
    """Pairs whose distance is within ``reach`` (Q, S) metres, one for each scan, of ``radius``."""
    places = (grid.points, grid.scan, grid.starts, grid.masks, grid.width)
    return Rim(*_rim(*places, queries, radius, reach))


def moments_around(
    points: NDArray[np.float64], places: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Moments (10, P), about the place, of ``points`` (N, 3) within ``radius`` of ``places`` (P, 3).

    All in metres.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    grid = make_grid(points, np.array([0, len(points)]), radius)
    parts = moments_of_parts(grid, np.ascontiguousarray(places, dtype=np.float64), radius, 1)
    return np.ascontiguousarray(parts[:, 0].T)


@kernel
def _sort(
    points: NDArray[np.float64],
    bounds: NDArray[np.int64],
    width: float,
    masks: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Points, scans and starts of a Grid."""
    mx, my, mz, scale = masks[0], masks[1], masks[2], 1.0 / width
    cubes = np.empty(len(points), dtype=np.int64)
    # Two places on, so that filling in the points makes the starts of the ends.
    starts = np.zeros((mx + 1) * (my + 1) * (mz + 1) + 2, dtype=np.int64)
    for i in range(len(points)):
        x, y, z = points[i, 0] * scale, points[i, 1] * scale, points[i, 2] * scale
        if abs(x) + abs(y) + abs(z) < MOST:
            cube = ((int(floor(x)) & mx) * (my + 1) + (int(floor(y)) & my)) * (mz + 1)
            cube += int(floor(z)) & mz
            cubes[i] = cube
            starts[cube + 2] += 1
        else:
            cubes[i] = -1
    for cube in range(2, len(starts)):
        starts[cube] += starts[cube - 1]
    placed = np.empty((starts[-1], 3))
    scan = np.empty(starts[-1], dtype=np.int64)
    for own in range(len(bounds) - 1):
        for i in range(bounds[own], bounds[own + 1]):
            if cubes[i] >= 0:
                place = starts[cubes[i] + 1]
                starts[cubes[i] + 1] += 1
                placed[place, 0], placed[place, 1] = points[i, 0], points[i, 1]
                placed[place, 2] = points[i, 2]
                scan[place] = own
    return placed, scan, starts[:-1]


@kernel
def _span(place: float, reach: float, width: float, mask: int) -> tuple[int, int]:
    """First cube along an axis within ``reach`` of ``place``, and the one after the last."""
    if not (abs(place) + reach) / width < MOST:
        return 0, 0
    first, last = int(floor((place - reach) / width)), int(floor((place + reach) / width))
    # Once around, the cubes come again.
    return first, min(last, first + mask) + 1


@kernel
def _moments(
    points: NDArray[np.float64],
    scan: NDArray[np.int64],
    starts: NDArray[np.int64],
    masks: NDArray[np.int64],
    width: float,
    queries: NDArray[np.float64],
    radius: float,
    scans: int,
) -> NDArray[np.float64]:
    """See moments_of_parts."""
    mx, my, mz = masks[0], masks[1], masks[2]
    limit = radius * radius
    sums = np.zeros((len(queries), scans, 10))
    for q in range(len(queries)):
        a, b, c = queries[q, 0], queries[q, 1], queries[q, 2]
        low_x, high_x = _span(a, radius, width, mx)
        low_y, high_y = _span(b, radius, width, my)
        low_z, high_z = _span(c, radius, width, mz)
        for i in range(low_x, high_x):
            for j in range(low_y, high_y):
                row = ((i & mx) * (my + 1) + (j & my)) * (mz + 1)
                for k in range(low_z, high_z):
                    cube = row + (k & mz)
                    for n in range(starts[cube], starts[cube + 1]):
                        x, y, z = points[n, 0] - a, points[n, 1] - b, points[n, 2] - c
                        if x * x + y * y + z * z <= limit:
                            own = sums[q, scan[n]]
                            own[0] += x * x
                            own[1] += x * y
                            own[2] += x * z
                            own[3] += x
                            own[4] += y * y
                            own[5] += y * z
                            own[6] += y
                            own[7] += z * z
                            own[8] += z
                            own[9] += 1.0
    return sums


@kernel
def _rim(
    points: NDArray[np.float64],
    scan: NDArray[np.int64],
    starts: NDArray[np.int64],
    masks: NDArray[np.int64],
    width: float,
    queries: NDArray[np.float64],
    radius: float,
    reach: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """Starts, steps and insides of a Rim."""
    mx, my, mz = masks[0], masks[1], masks[2]
    count, scans = reach.shape
    bounds = np.zeros((count, scans + 1), dtype=np.int64)
    near = np.empty(64, dtype=np.int64)  # the points of the pairs, as they are found
    places = np.empty(scans, dtype=np.int64)
    done = 0
    for q in range(count):
        a, b, c = queries[q, 0], queries[q, 1], queries[q, 2]
        widest = 0.0
        for s in range(scans):
            widest = max(widest, reach[q, s])
            places[s] = 0
        begun = done
        # Most pairs are too near or too far for any reach.
        most = (radius + widest) * (radius + widest)
        least = max(radius - widest, 0.0) * max(radius - widest, 0.0)
        low_x, high_x = _span(a, radius + widest, width, mx)
        low_y, high_y = _span(b, radius + widest, width, my)
        low_z, high_z = _span(c, radius + widest, width, mz)
        for i in range(low_x, high_x):
            for j in range(low_y, high_y):
                row = ((i & mx) * (my + 1) + (j & my)) * (mz + 1)
                for k in range(low_z, high_z):
                    cube = row + (k & mz)
                    for n in range(starts[cube], starts[cube + 1]):
                        x, y, z = points[n, 0] - a, points[n, 1] - b, points[n, 2] - c
                        square = x * x + y * y + z * z
                        if least <= square <= most:
                            if abs(sqrt(square) - radius) <= reach[q, scan[n]]:
                                if done == len(near):
                                    longer = np.empty(2 * done, dtype=np.int64)
                                    longer[:done] = near
                                    near = longer
                                near[done] = n
                                places[scan[n]] += 1
                                done += 1
        bounds[q, 0] = begun
        for s in range(scans):
            bounds[q, s + 1] = bounds[q, s] + places[s]
    apart, inside = np.empty((done, 3)), np.empty(done, dtype=np.bool_)
    for q in range(count):
        places[:] = bounds[q, :-1]
        for i in range(bounds[q, 0], bounds[q, scans]):
            n = near[i]
            place = places[scan[n]]
            places[scan[n]] += 1
            x, y, z = points[n, 0] - queries[q, 0], points[n, 1] - queries[q, 1], points[n, 2] - queries[q, 2]
            apart[place, 0], apart[place, 1], apart[place, 2] = x, y, z
            inside[place] = x * x + y * y + z * z <= radius * radius
    return bounds, apart, inside
