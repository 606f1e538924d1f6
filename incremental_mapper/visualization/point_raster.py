"""Painting many points into pixels, compiled: a drawing library takes ten times as long."""

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.compiled import kernel

FINE = 64
"""Parts of a pixel's side that are looked at for how much of it a mark covers."""
HIDDEN = np.float32(1.0 / 512.0)
"""Share of what lies below a pixel that is not seen any more: less than a step of its colour."""


def paint(
    spots: NDArray[np.float64],
    shades: NDArray[np.uint8],
    colours: NDArray[np.floating],
    mark: tuple[float, float],
    shape: tuple[int, int],
) -> NDArray[np.uint8]:
    """Paint round marks, those of a higher shade over those of a lower one.

    Args:
        spots: Where (N, 2), in columns and rows of pixels from the upper left corner.
        shades: Which of the colours each of them has (N,).
        colours: Red, green and blue (K, 3), from 0 to 1.
        mark: Diameter in pixels, and opacity.
        shape: Rows and columns of pixels.

    Returns:
        Red, green, blue and opacity (rows, columns, 4).
    """
    # From the front to the back: where nothing shines through, nothing more is to be done.
    order = np.argsort(shades, kind='stable')[::-1]
    inks, clear = np.zeros((*shape, 3), dtype=np.float32), np.ones(shape, dtype=np.float32)
    offsets, covers = _stencil(*mark)
    _stamp(spots, order, shades, colours.astype(np.float32), offsets, covers, inks, clear)
    return _as_bytes(inks, clear)


def _stencil(diameter: float, opacity: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Pixels (K, 2) that a mark on the middle of one covers, and how much of them (K,)."""
    reach = int(np.ceil((diameter - 1.0) / 2.0))
    count = 2 * reach + 1
    fine = (np.arange(count * FINE) + 0.5) / FINE - count / 2
    inside = fine[:, None] ** 2 + fine**2 <= (diameter / 2.0) ** 2
    share = inside.reshape(count, FINE, count, FINE).mean(axis=(1, 3))
    taken = np.argwhere(share > 0.0)
    covers = (opacity * share[share > 0.0]).astype(np.float32)
    return taken - reach, covers


@kernel
def _stamp(
    spots: NDArray[np.float64],
    order: NDArray[np.int64],
    shades: NDArray[np.uint8],
    colours: NDArray[np.float32],
    offsets: NDArray[np.int64],
    covers: NDArray[np.float32],
    inks: NDArray[np.float32],
    clear: NDArray[np.float32],
) -> None:
    """Add the marks below what is painted: ``clear`` is what shines through ``inks``."""
    rows, columns = clear.shape
    for i in order:
        x, y = np.floor(spots[i, 0]), np.floor(spots[i, 1])
        if not (-columns < x < 2 * columns and -rows < y < 2 * rows):  # NaN is not
            continue
        column, row, shade = int(x), int(y), shades[i]
        for k in range(len(covers)):
            r, c = row + offsets[k, 0], column + offsets[k, 1]
            if r < 0 or r >= rows or c < 0 or c >= columns or clear[r, c] < HIDDEN:
                continue
            own = clear[r, c] * covers[k]
            clear[r, c] -= own
            for j in range(3):
                inks[r, c, j] += own * colours[shade, j]


@kernel
def _as_bytes(inks: NDArray[np.float32], clear: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colour and opacity (rows, columns, 4) of pixels, the colour not dimmed by the opacity."""
    rows, columns = clear.shape
    pixels = np.zeros((rows, columns, 4), dtype=np.uint8)
    for r in range(rows):
        for c in range(columns):
            solid = np.float32(1.0) - clear[r, c]
            if solid > 0.0:
                for j in range(3):
                    pixels[r, c, j] = np.uint8(min(255.0 * inks[r, c, j] / solid + 0.5, 255.0))
                pixels[r, c, 3] = np.uint8(255.0 * solid + 0.5)
    return pixels
