"""Marks painted into pixels, against the same painted one after the other, from the back."""

import numpy as np
import pytest

from incremental_mapper.visualization.point_raster import paint

COLOURS = np.array([[0.1, 0.2, 0.9], [0.2, 0.8, 0.3], [0.9, 0.7, 0.0]])


def covered(diameter: float, row: int, column: int) -> float:
    """How much of a pixel a mark on the middle of pixel 0, 0 covers."""
    fine = (np.arange(200) + 0.5) / 200 - 0.5
    x, y = column + fine[:, None], row + fine
    return float(np.mean(x**2 + y**2 <= diameter**2 / 4))


def one_after_the_other(spots, shades, mark, shape):
    """Colour and opacity (rows, columns, 4), each mark laid over all before it."""
    diameter, opacity = mark
    reach = range(-4, 5)
    cover = {(r, c): opacity * covered(diameter, r, c) for r in reach for c in reach}
    dimmed, solid = np.zeros((*shape, 3)), np.zeros(shape)
    for i in np.argsort(shades, kind='stable'):
        column, row = np.floor(spots[i]).astype(int)
        for (down, right), own in cover.items():
            r, c = row + down, column + right
            if 0 <= r < shape[0] and 0 <= c < shape[1]:
                dimmed[r, c] = own * COLOURS[shades[i]] + (1.0 - own) * dimmed[r, c]
                solid[r, c] = own + (1.0 - own) * solid[r, c]
    return np.dstack([dimmed / np.maximum(solid, 1e-9)[..., None], solid])


@pytest.mark.parametrize('mark', [(1.0, 1.0), (2.1, 0.45), (6.5, 0.9)])
def test_what_is_higher_lies_over_what_is_lower(mark):
    rng = np.random.default_rng(1)
    shape = (12, 20)
    spots = rng.uniform([-6.0, -6.0], [26.0, 18.0], (150, 2))  # some beyond each side
    shades = rng.integers(0, 3, len(spots)).astype(np.uint8)
    exact = one_after_the_other(spots, shades, mark, shape)
    pixels = paint(spots, shades, COLOURS, mark, shape) / 255.0
    assert np.abs(pixels[..., 3] - exact[..., 3]).max() < 0.02
    apart = np.abs(pixels - exact)[..., :3] * exact[..., 3:]
    assert apart.max() < 0.02
    assert 0.1 < exact[..., 3].mean() < 1.0


def test_what_is_nowhere_is_not_painted():
    far = np.array([[np.nan, 1.0], [1.0, np.inf], [-1e300, 2.0], [1e300, 2.0], [3.5, 2.5]])
    pixels = paint(far, np.zeros(5, dtype=np.uint8), COLOURS, (1.0, 1.0), (4, 5))
    assert np.argwhere(pixels[..., 3] > 0).tolist() == [[2, 3]]
    nothing = paint(np.zeros((0, 2)), np.zeros(0, dtype=np.uint8), COLOURS, (1.0, 1.0), (4, 5))
    assert nothing.shape == (4, 5, 4) and not nothing.any()
