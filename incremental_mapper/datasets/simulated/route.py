"""The closed road that a simulated car follows, by arc length."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated.smooth_step import step, step_slope

Array = NDArray[np.float64]

PEAK_SLOPE = 35.0 / 16.0
CELL = 0.5
NODES, WEIGHTS = np.polynomial.legendre.leggauss(7)


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of road: ``length`` in metres and the heading change ``turn`` in radians."""

    length: float
    turn: float = 0.0

    @property
    def curvature(self) -> float:
        """Largest curvature in 1/m."""
        return PEAK_SLOPE * abs(self.turn) / self.length


def bend(turn: float, radius: float) -> Piece:
    """A bend by ``turn`` radians that is nowhere tighter than ``radius`` metres."""
    return Piece(PEAK_SLOPE * abs(turn) * radius, turn)


class Route:
    """A loop of pieces in the plane; arc lengths beyond it continue on the next lap.

    The loop starts at ``origin`` with heading 0 and must close; see ``closing_error``.
    """

    def __init__(self, pieces: Sequence[Piece], origin: tuple[float, float] = (0.0, 0.0)) -> None:
        self.pieces = tuple(pieces)
        self._origin = np.array(origin)
        self.starts: Array = np.concatenate(
            [[0.0], np.cumsum([piece.length for piece in self.pieces])]
        )
        self.length = float(self.starts[-1])
        self._lengths = np.array([piece.length for piece in self.pieces])
        self._turns = np.array([piece.turn for piece in self.pieces])
        self._headings = np.concatenate([[0.0], np.cumsum(self._turns)])
        # Position on a coarse grid; in between, the heading is integrated from the grid point on.
        grid = np.arange(0.0, self.length, CELL)
        ends = np.append(grid[1:], self.length)
        knots = np.cumsum(self._integrate(grid, ends), axis=0)
        self._knots: Array = self._origin + np.concatenate([np.zeros((1, 2)), knots])

    @property
    def end(self) -> Array:
        """Where the last piece ends, (2,) metres."""
        end: Array = self._knots[-1]
        return end

    @property
    def closing_error(self) -> float:
        """Distance in metres between the end of the loop and its start."""
        return float(np.linalg.norm(self.end - self._origin))

    def heading(self, arc: Array) -> Array:
        """Heading in radians at arc lengths (N,), continuous over the laps."""
        laps, index, inside = self._locate(arc)
        local: Array = self._headings[index] + self._turns[index] * step(inside)
        local += laps * self._headings[-1]
        return local

    def curvature(self, arc: Array) -> Array:
        """Signed curvature in 1/m at arc lengths (N,), positive to the left."""
        _, index, inside = self._locate(arc)
        curvature: Array = self._turns[index] / self._lengths[index] * step_slope(inside)
        return curvature

    def position(self, arc: Array) -> Array:
        """Positions (N, 2) in metres at arc lengths (N,)."""
        local = np.mod(arc, self.length)
        cell = np.minimum((local / CELL).astype(np.int64), len(self._knots) - 2)
        position: Array = self._knots[cell] + self._integrate(cell * CELL, local)
        return position

    def _locate(self, arc: Array) -> tuple[Array, NDArray[np.int64], Array]:
        laps = np.floor(arc / self.length)
        local = arc - laps * self.length
        index = np.searchsorted(self.starts[1:-1], local, side='right')
        return laps, index, (local - self.starts[index]) / self._lengths[index]

    def _integrate(self, start: Array, end: Array) -> Array:
        """Displacement (N, 2) between arc lengths, by Gauss-Legendre quadrature."""
        half = (end - start) / 2.0
        arcs = (start + half)[:, None] + half[:, None] * NODES
        headings = self.heading(arcs.ravel()).reshape(arcs.shape)
        shift = np.stack([np.cos(headings) @ WEIGHTS, np.sin(headings) @ WEIGHTS], axis=1)
        displacement: Array = shift * half[:, None]
        return displacement


def polygon_route(corners: Array, radii: Sequence[float]) -> Route:
    """The loop along a closed polygon with rounded corners.

    ``corners`` is (M, 2) metres, ``radii`` the tightest radius at each of them. The loop starts
    on the side from the first to the second corner, which must run along +x.
    """
    sides = np.roll(corners, -1, axis=0) - corners
    headings = np.arctan2(sides[:, 1], sides[:, 0])
    # Turn at the end of each side, in (-pi, pi).
    turns = np.angle(np.exp(1j * (np.roll(headings, -1) - headings)))
    bends = [
        bend(float(turn), radius)
        for turn, radius in zip(turns, [*radii[1:], radii[0]], strict=True)
    ]
    tangents = np.array([_tangent_length(piece) for piece in bends])
    straights = np.linalg.norm(sides, axis=1) - tangents - np.roll(tangents, 1)
    pieces: list[Piece] = []
    for straight, piece in zip(straights.tolist(), bends, strict=True):
        pieces += [Piece(straight), piece]
    return Route(pieces, origin=(float(corners[0, 0] + tangents[-1]), float(corners[0, 1])))


def winding_route(straight: float, outer: Piece, inner: Piece, repeats: int) -> Route:
    """A loop of ``repeats`` equal parts, each a straight, a bend, a straight and a counter-bend.

    It closes because of its symmetry where the turns of all parts add up to one revolution.
    """
    return Route([Piece(straight), outer, Piece(straight), inner] * repeats)


def _tangent_length(piece: Piece) -> float:
    """Distance from the beginning of a bend to the corner of its tangents, in metres."""
    end = Route([piece]).end
    return float(end[0] - end[1] / np.tan(piece.turn))
