"""How the moments of neighbourhoods change between candidates.

Let scan s hold a point p and scan t the query q, both placed at the reference, and let a candidate
move them by D_s = (R_s, τ_s) and D_t. With p = q + u they are then R_s(u + f) apart, where
f = R_sᵀ(D_s − D_t) q is the drift: it is the same for all points of the scan. So the moments of
its points about q are shifted by f and turned by R_tᵀR_s, which brings those of all scans into
one frame. The distance of a pair changes by at most |f|: pairs whose distance is further from the
radius than any candidate's drift stay in or out. The few others, the boundary
pairs, are looked at again for every candidate.
"""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel
from incremental_mapper.scoring.neighbourhoods import BoundaryPairs

ROUNDING = 1e-9
"""Metres that a distance may be off by rounding."""


def largest_drifts(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    scan: NDArray[np.int64],
    limit: float,
) -> NDArray[np.float64]:
    """Largest drifts (Q, S) in metres of the candidates that drift by no more than ``limit``.

    ``motions`` (C, S, 4, 4) are the D_s, ``queries`` (Q, 3) those of the scans ``scan`` (Q,). The
    other candidates would make boundaries that cost more than to search again for them alone.
    """
    rows = np.ascontiguousarray(queries.T)
    ends = np.searchsorted(scan, np.arange(motions.shape[1]), side='right')
    squares = _largest_squares(np.ascontiguousarray(motions), rows, ends, limit * limit)
    return np.ascontiguousarray(np.sqrt(squares).T)


def moved_covariances(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    scan: NDArray[np.int64],
    moments: NDArray[np.float64],
    boundary: BoundaryPairs,
    reach: NDArray[np.float64],
    radius: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Covariances (6, C, Q) of neighbourhoods, xx, xy, xz, yy, yz, zz, as candidates move them.

    ``motions`` (C, S, 4, 4) are the D_s; ``queries`` (Q, 3), ``scan`` (Q,), the moments ``moments``
    (Q, S, 10) and the pairs at the ``boundary`` are those of the reference. Also tells which
    candidates (C,) drift by no more than ``reach`` (Q, S); the covariances of the others are NaN.
    """
    return _moved(
        np.ascontiguousarray(motions),
        queries,
        scan,
        moments,
        boundary.starts,
        boundary.apart,
        boundary.inside,
        np.square(reach + 0.1 * ROUNDING),
        radius,
    )


@kernel
def _against(
    motions: NDArray[np.float64],
    own: int,
    steps: NDArray[np.float64],
    turns: NDArray[np.float64],
) -> None:
    """Drifts f = ``steps`` (S, 3, 4) times (q, 1), and ``turns`` (S, 3, 3), of a candidate.

    ``motions`` (S, 4, 4) are the D_s and ``own`` is the scan of the queries.
    """
    t = motions[own]
    for s in range(len(motions)):
        m = motions[s]
        for i in range(3):
            for j in range(4):
                steps[s, i, j] = (
                    m[0, i] * (m[0, j] - t[0, j])
                    + m[1, i] * (m[1, j] - t[1, j])
                    + m[2, i] * (m[2, j] - t[2, j])
                )
            for j in range(3):
                turns[s, i, j] = t[0, i] * m[0, j] + t[1, i] * m[1, j] + t[2, i] * m[2, j]


@kernel
def _largest_squares(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    ends: NDArray[np.int64],
    limit: float,
) -> NDArray[np.float64]:
    """Largest squared drifts (S, Q) of the candidates whose squared drifts are within ``limit``.

    The queries (3, Q) of scan s end before ends[s].
    """
    count, scans, size = motions.shape[0], motions.shape[1], queries.shape[1]
    placed, squares = np.empty((3, size)), np.empty((scans, size))
    largest = np.zeros((scans, size))
    for c in range(count):
        start = 0
        for s in range(scans):
            for k in range(3):
                x, y, z, shift = (
                    motions[c, s, k, 0],
                    motions[c, s, k, 1],
                    motions[c, s, k, 2],
                    motions[c, s, k, 3],
                )
                for q in range(start, ends[s]):
                    placed[k, q] = x * queries[0, q] + y * queries[1, q] + z * queries[2, q] + shift
            start = ends[s]
        near = True
        for s in range(scans):
            for q in range(size):
                squares[s, q] = 0.0
            for k in range(3):
                x, y, z, shift = (
                    motions[c, s, k, 0],
                    motions[c, s, k, 1],
                    motions[c, s, k, 2],
                    motions[c, s, k, 3],
                )
                for q in range(size):
                    step = x * queries[0, q] + y * queries[1, q] + z * queries[2, q] + shift
                    step -= placed[k, q]
                    squares[s, q] += step * step
            for q in range(size):
                near &= squares[s, q] <= limit  # NaN is not
        if near:
            for s in range(scans):
                for q in range(size):
                    largest[s, q] = max(largest[s, q], squares[s, q])
    return largest


@kernel
def _moved(
    motions: NDArray[np.float64],
    queries: NDArray[np.float64],
    scan: NDArray[np.int64],
    moments: NDArray[np.float64],
    starts: NDArray[np.int64],
    apart: NDArray[np.float64],
    inside: NDArray[np.bool_],
    allowed: NDArray[np.float64],
    radius: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """See moved_covariances; ``allowed`` (Q, S) are the squares of the reach."""
    count, scans = motions.shape[0], motions.shape[1]
    found = np.empty((6, count, len(queries)))
    near = np.empty(count, dtype=np.bool_)
    steps, turns = np.empty((scans, 3, 4)), np.empty((scans, 3, 3))
    for c in range(count):
        own, near[c] = -1, True
        for q in range(len(queries)):
            if scan[q] != own:
                own = scan[q]
                _against(motions[c], own, steps, turns)
            a, b, d = queries[q, 0], queries[q, 1], queries[q, 2]
            # Moments of the whole neighbourhood, about the query and in the turned frame.
            txx = txy = txz = tyy = tyz = tzz = tx = ty = tz = total = 0.0
            for s in range(scans):
                m = steps[s]
                f = m[0, 0] * a + m[0, 1] * b + m[0, 2] * d + m[0, 3]
                g = m[1, 0] * a + m[1, 1] * b + m[1, 2] * d + m[1, 3]
                h = m[2, 0] * a + m[2, 1] * b + m[2, 2] * d + m[2, 3]
                if not f * f + g * g + h * h <= allowed[q, s]:
                    near[c] = False
                    break
                p = moments[q, s]
                xx, xy, xz, x = p[0], p[1], p[2], p[3]
                yy, yz, y, zz, z, n = p[4], p[5], p[6], p[7], p[8], p[9]
                for i in range(starts[q, s], starts[q, s + 1]):
                    u, v, w = apart[i, 0], apart[i, 1], apart[i, 2]
                    square = (u + f) * (u + f) + (v + g) * (v + g) + (w + h) * (w + h)
                    if (square <= radius * radius) != inside[i]:
                        sign = -1.0 if inside[i] else 1.0
                        xx, xy, xz = xx + sign * u * u, xy + sign * u * v, xz + sign * u * w
                        yy, yz, zz = yy + sign * v * v, yz + sign * v * w, zz + sign * w * w
                        x, y, z, n = x + sign * u, y + sign * v, z + sign * w, n + sign
                if n == 0.0:
                    continue
                xx += f * (2.0 * x + n * f)
                xy += f * y + g * (x + n * f)
                xz += f * z + h * (x + n * f)
                yy += g * (2.0 * y + n * g)
                yz += g * z + h * (y + n * g)
                zz += h * (2.0 * z + n * h)
                x, y, z = x + n * f, y + n * g, z + n * h
                r = turns[s]
                ax, ay, az = r[0, 0], r[0, 1], r[0, 2]
                bx, by, bz = r[1, 0], r[1, 1], r[1, 2]
                cx, cy, cz = r[2, 0], r[2, 1], r[2, 2]
                ux, uy, uz = (
                    xx * ax + xy * ay + xz * az,
                    xy * ax + yy * ay + yz * az,
                    xz * ax + yz * ay + zz * az,
                )
                vx, vy, vz = (
                    xx * bx + xy * by + xz * bz,
                    xy * bx + yy * by + yz * bz,
                    xz * bx + yz * by + zz * bz,
                )
                wx, wy, wz = (
                    xx * cx + xy * cy + xz * cz,
                    xy * cx + yy * cy + yz * cz,
                    xz * cx + yz * cy + zz * cz,
                )
                txx += ax * ux + ay * uy + az * uz
                txy += ax * vx + ay * vy + az * vz
                txz += ax * wx + ay * wy + az * wz
                tyy += bx * vx + by * vy + bz * vz
                tyz += bx * wx + by * wy + bz * wz
                tzz += cx * wx + cy * wy + cz * wz
                tx += ax * x + ay * y + az * z
                ty += bx * x + by * y + bz * z
                tz += cx * x + cy * y + cz * z
                total += n
            if not near[c]:
                break
            share = 1.0 / max(total, 1.0)
            tx, ty, tz = tx * share, ty * share, tz * share
            found[0, c, q] = txx * share - tx * tx
            found[1, c, q] = txy * share - tx * ty
            found[2, c, q] = txz * share - tx * tz
            found[3, c, q] = tyy * share - ty * ty
            found[4, c, q] = tyz * share - ty * tz
            found[5, c, q] = tzz * share - tz * tz
        if not near[c]:
            for k in range(6):
                for q in range(len(queries)):
                    found[k, c, q] = np.nan
    return found, near
