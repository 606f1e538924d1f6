"""Which points lie around a query, and the moments that they have there.

Every window asks once, and of points that stand elsewhere in the next window, so that building a
tree does not pay. The points are sorted into cubes instead, by counting. Along x and y the cubes
are numbered periodically, and along z the outer layers take in what is beyond them: points that
are far from each other may share a cube, which costs a look at them, but however far the points
spread there are hardly more cubes than points.
"""

from dataclasses import dataclass
from math import floor, sqrt

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

MOST = 1e15
"""Numbers of cubes count exactly up to here; no point is further out."""

SOME = 200
"""Points that tell about how high the others are."""


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Points sorted into cubes.

    ``points`` (N, 3) in metres and their ``scan`` (N,) lie in the order of the cubes, those that
    are not finite left out. Cube i has the points ``starts[i]`` to ``starts[i + 1]``; those above
    each other follow one another. ``shape`` (5,) is the width of a cube in metres, the height
    (in cubes) of the lowest layer, and the numbers of cubes along x, y, z less one.
    """

    points: NDArray[np.float64]
    scan: NDArray[np.int32]
    starts: NDArray[np.int32]
    shape: tuple[float, float, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class BoundaryPairs:
    """Pairs of a query and a point near the boundary of its ball, sorted by query and scan.

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
    bits = max(len(points).bit_length() - 1, 6)
    # The world is flat: fewer cubes are stacked than lie side by side.
    up = bits // 4
    across = (bits - up) // 2
    masks = (1 << (bits - up - across)) - 1, (1 << across) - 1, (1 << up) - 1
    placed, scan, starts, low = _sort(points, bounds, width, *masks)
    return Grid(placed, scan, starts[:-1], (width, low, *masks))


def scan_moments(
    grid: Grid, queries: NDArray[np.float64], radius: float, scans: int
) -> NDArray[np.float64]:
    """Moments (Q, S, 10) of each scan's points within ``radius`` of ``queries`` (Q, 3).

    About the query, whose points are near and so keep the moments exact.
    """
    return _moments(grid.points, grid.scan, grid.starts, grid.shape, queries, radius, scans)


def shared_neighbourhoods(
    moments: NDArray[np.float64], scan: NDArray[np.int64], least: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which queries have at least so many points around, and some of another scan than their own.

    ``moments`` (Q, S, 10) are the moments and ``scan`` (Q,) the queries' own scans. Comes with the
    covariances (6, K) of the neighbourhoods, xx, xy, xz, yy, yz, zz.
    """
    chosen, spread, kept = _shared(moments, scan, least)
    return chosen[:kept], spread[:, :kept]


def find_boundary_pairs(
    grid: Grid, queries: NDArray[np.float64], radius: float, reach: NDArray[np.float64]
) -> BoundaryPairs:
    """Pairs whose distance is within ``reach`` (Q, S) metres, one for each scan, of ``radius``."""
    starts, apart, inside, count = _boundary(
        grid.points, grid.scan, grid.starts, grid.shape, queries, radius, reach
    )
    return BoundaryPairs(starts, apart[:count], inside[:count])


def moments_around(
    points: NDArray[np.float64], places: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Moments (10, P) of the ``points`` (N, 3) within ``radius`` metres of ``places`` (P, 3).

    About the place itself.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    grid = make_grid(points, np.array([0, len(points)]), radius)
    moments = scan_moments(grid, np.ascontiguousarray(places, dtype=np.float64), radius, 1)
    return np.ascontiguousarray(moments[:, 0].T)


@kernel
def _sort(
    points: NDArray[np.float64], bounds: NDArray[np.int64], width: float, mx: int, my: int, mz: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32], float]:
    """Points, scans and starts (and one more) of a Grid, and the height of its lowest layer."""
    scale, total, finite = 1.0 / width, 0.0, 0
    for i in range(0, len(points), max(len(points) // SOME, 1)):
        if abs(points[i, 2]) * scale < MOST:
            total, finite = total + points[i, 2] * scale, finite + 1
    low = floor(total / max(finite, 1)) - 0.5 * (mz + 1)
    cubes = np.empty(len(points), dtype=np.int32)
    # Two places on, so that filling in the points makes the starts of the ends.
    starts = np.zeros((mx + 1) * (my + 1) * (mz + 1) + 2, dtype=np.int32)
    for i in range(len(points)):
        x, y, z = points[i, 0] * scale, points[i, 1] * scale, points[i, 2] * scale
        cubes[i] = -1
        if abs(x) + abs(y) + abs(z) < MOST:
            cube = ((floor(x) & mx) * (my + 1) + (floor(y) & my)) * (mz + 1)
            cube += min(max(floor(z - low), 0), mz)
            cubes[i] = cube
            starts[cube + 2] += 1
    for cube in range(2, len(starts)):
        starts[cube] += starts[cube - 1]
    placed = np.empty((starts[-1], 3))
    scan = np.empty(starts[-1], dtype=np.int32)
    for own in range(len(bounds) - 1):
        for i in range(bounds[own], bounds[own + 1]):
            if cubes[i] >= 0:
                place = starts[cubes[i] + 1]
                starts[cubes[i] + 1] += 1
                placed[place, 0], placed[place, 1] = points[i, 0], points[i, 1]
                placed[place, 2] = points[i, 2]
                scan[place] = own
    return placed, scan, starts, low


@kernel
def _between(
    points: NDArray[np.float64],
    starts: NDArray[np.int32],
    shape: tuple[float, float, int, int, int],
    query: NDArray[np.float64],
    least: float,
    most: float,
    near: NDArray[np.int32],
) -> int:
    """How many points are ``least`` to ``most`` metres from the query (3,); ``near`` names them."""
    width, low, mx, my, mz = shape
    a, b, c, scale = query[0], query[1], query[2], 1.0 / width
    if not (abs(a) + abs(b) + abs(c) + most) * scale < MOST:
        return 0
    # Once around, the cubes come again.
    first_x, first_y = floor((a - most) * scale), floor((b - most) * scale)
    last_x = min(floor((a + most) * scale), first_x + mx)
    last_y = min(floor((b + most) * scale), first_y + my)
    # The lowest and the highest layer also have what is beyond them.
    bottom = min(max(floor((c - most) * scale - low), 0), mz)
    top = min(max(floor((c + most) * scale - low), 0), mz)
    count = np.uint64(0)
    for i in range(first_x, last_x + 1):
        for j in range(first_y, last_y + 1):
            row = ((i & mx) * (my + 1) + (j & my)) * (mz + 1)
            # Unsigned, so that no index is taken for one from the end.
            for n in range(np.uint64(starts[row + bottom]), np.uint64(starts[row + top + 1])):
                x, y, z = points[n, 0] - a, points[n, 1] - b, points[n, 2] - c
                square = x * x + y * y + z * z
                # Without a branch, which could not be foreseen.
                near[count] = n
                count += np.uint64((least * least <= square) & (square <= most * most))
    return int(count)


@kernel
def _moments(
    points: NDArray[np.float64],
    scan: NDArray[np.int32],
    starts: NDArray[np.int32],
    shape: tuple[float, float, int, int, int],
    queries: NDArray[np.float64],
    radius: float,
    scans: int,
) -> NDArray[np.float64]:
    """See scan_moments."""
    near = np.empty(len(points) + 1, dtype=np.int32)
    sums = np.zeros((len(queries), scans, 10))
    for q in range(len(queries)):
        query = queries[q]
        for i in range(_between(points, starts, shape, query, 0.0, radius, near)):
            n = near[i]
            x, y, z = points[n, 0] - query[0], points[n, 1] - query[1], points[n, 2] - query[2]
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
def _shared(
    moments: NDArray[np.float64], scan: NDArray[np.int64], least: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
    """See shared_neighbourhoods; what is behind the first so many is void."""
    count, scans = moments.shape[0], moments.shape[1]
    chosen, spread, kept = np.empty(count, dtype=np.int64), np.empty((6, count)), 0
    m = np.empty(10)
    for q in range(count):
        total = 0.0
        for s in range(scans):
            total += moments[q, s, 9]
        if not total >= max(least, 1) or total == moments[q, scan[q], 9]:
            continue
        for i in range(10):
            m[i] = 0.0
            for s in range(scans):
                m[i] += moments[q, s, i]
            m[i] /= total
        spread[0, kept], spread[1, kept] = m[0] - m[3] * m[3], m[1] - m[3] * m[6]
        spread[2, kept], spread[3, kept] = m[2] - m[3] * m[8], m[4] - m[6] * m[6]
        spread[4, kept], spread[5, kept] = m[5] - m[6] * m[8], m[7] - m[8] * m[8]
        chosen[kept] = q
        kept += 1
    return chosen, spread, kept


@kernel
def _boundary(
    points: NDArray[np.float64],
    scan: NDArray[np.int32],
    starts: NDArray[np.int32],
    shape: tuple[float, float, int, int, int],
    queries: NDArray[np.float64],
    radius: float,
    reach: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_], int]:
    """Starts, steps and insides of a BoundaryPairs, and its size: what is behind it is void."""
    count, scans = reach.shape
    near = np.empty(len(points) + 1, dtype=np.int32)
    bounds = np.zeros((count, scans + 1), dtype=np.int64)
    places = np.empty(scans, dtype=np.int64)
    apart, inside = np.empty((64, 3)), np.empty(64, dtype=np.bool_)
    done = 0
    for q in range(count):
        query, widest = queries[q], 0.0
        for s in range(scans):
            widest = max(widest, reach[q, s])
            places[s] = 0
        least, most = max(radius - widest, 0.0), radius + widest
        found = _between(points, starts, shape, query, least, most, near)
        kept = 0
        for i in range(found):
            n = near[i]
            x, y, z = points[n, 0] - query[0], points[n, 1] - query[1], points[n, 2] - query[2]
            if abs(sqrt(x * x + y * y + z * z) - radius) <= reach[q, scan[n]]:
                near[kept] = n
                places[scan[n]] += 1
                kept += 1
        if done + kept > len(inside):
            longer, more = np.empty((2 * (done + kept), 3)), np.empty(2 * (done + kept), np.bool_)
            for i in range(done):
                longer[i, 0], longer[i, 1], longer[i, 2] = apart[i, 0], apart[i, 1], apart[i, 2]
                more[i] = inside[i]
            apart, inside = longer, more
        bounds[q, 0] = done
        for s in range(scans):
            bounds[q, s + 1] = bounds[q, s] + places[s]
            places[s] = bounds[q, s]
        for i in range(kept):
            n = near[i]
            x, y, z = points[n, 0] - query[0], points[n, 1] - query[1], points[n, 2] - query[2]
            place = places[scan[n]]
            places[scan[n]] += 1
            apart[place, 0], apart[place, 1], apart[place, 2] = x, y, z
            inside[place] = x * x + y * y + z * z <= radius * radius
        done += kept
    return bounds, apart, inside, done
