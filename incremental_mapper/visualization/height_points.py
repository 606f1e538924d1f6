"""Points of a map, coloured by how high they lie over the way."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.visualization.figure import (
    DARK,
    DPI,
    LIGHT,
    PAGE,
    PAGE_DPI,
    Look,
    axes_pixels,
)
from incremental_mapper.visualization.point_raster import paint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap, Normalize

EVENED = 0.6
"""Share of the colours that follows the ranks of heights; the rest follows the heights."""
STEPS = 256
"""Heights at which the scale of the colours bends."""
SHADES = 64
"""Colours of points; the eye tells fewer."""
SNAPPED = 1.3
"""How much larger a mark is drawn, as none is drawn between pixels."""
SAMPLE = 50_000
"""Points from which the shares of all are told; more change no colour that one can see."""


def draw_points(
    axes: 'Axes', flat: NDArray[np.float64], heights: NDArray[np.float64], look: Look
) -> None:
    """Draw points coloured by their heights, and beside the axes what the colours say.

    Args:
        axes: Where, with their limits set.
        flat: Points (N, 2), metres.
        heights: Their heights (N,) over the way, metres.
        look: Colours and sizes.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.image import AxesImage

    norm, colours = _evened(heights), _height_colours(look)
    size, alpha = _mark(axes, flat)
    density = (PAGE_DPI if look.theme is PAGE else DPI) / DPI
    shades = (np.asarray(norm(heights)).clip(0.0, 1.0) * SHADES).astype(np.uint8)
    pixels = paint(
        _spots(axes, flat, density),
        shades.clip(max=SHADES - 1),
        colours((np.arange(SHADES) + 0.5) / SHADES)[:, :3],
        (density * size, alpha),
        _pixels(axes, density),
    )
    # As the image stands for lines, it lies where they do: over the grid.
    image = AxesImage(
        axes, interpolation='none', origin='upper', zorder=2.0,
        extent=(*axes.get_xlim(), *axes.get_ylim()),
    )  # fmt: skip
    image.set_data(pixels)
    image.set_clip_path(axes.patch)
    axes.add_image(image)
    place = axes.get_position()
    gap, width = 24 / look.width, (22 if look.heading else 12) / look.width
    gap = gap if look.heading else gap / 2
    beside = (place.x1 + gap, place.y0, width, place.height)
    figure = axes.get_figure(root=True)
    bar = figure.colorbar(  # type: ignore[union-attr]
        ScalarMappable(norm, colours), cax=axes.figure.add_axes(beside), extend='both',
        extendfrac=0.02,
    )  # fmt: skip
    bar.outline.set_edgecolor(look.theme.frame)
    bar.ax.tick_params(colors=look.theme.muted, labelsize=look.text - 1, length=3)
    bar.ax.set_yticks(_bar_ticks(norm))
    bar.ax.minorticks_off()
    bar.set_label('height above the way, m', fontsize=look.text, color=look.theme.ink)


def sample(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every k-th of rows (N, ...), which come in the order of the drive: about ``SAMPLE``."""
    return rows[:: max(1, len(rows) // SAMPLE)]


def _pixels(axes: 'Axes', density: float) -> tuple[int, int]:
    """Rows and columns of the pixels of an axes."""
    width, height = axes_pixels(axes)
    return max(round(height * density), 1), max(round(width * density), 1)


def _spots(axes: 'Axes', flat: NDArray[np.float64], density: float) -> NDArray[np.float64]:
    """Where points (N, 2) lie, in columns and rows of an axes' pixels from its upper left."""
    rows, columns = _pixels(axes, density)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    scale = np.array([columns / (right - left), rows / (bottom - top)])
    # A mark lies on the middle of a pixel: what stands on a grid itself would show a weave.
    jitter = np.random.default_rng(0).uniform(-0.5, 0.5, flat.shape)
    spots: NDArray[np.float64] = (flat - [left, top]) * scale + jitter
    return spots


def _evened(heights: NDArray[np.float64]) -> 'Normalize':
    """Colours for heights (N,): partly by rank, so that a few tall houses leave some for streets.

    By rank alone a flat road would have all colours for its last centimetres.
    """
    from matplotlib.colors import FuncNorm

    heights = sample(heights)
    low, high = np.percentile(heights, [1.0, 99.0]) if len(heights) > 0 else (0.0, 1.0)
    edges = np.linspace(low, max(high, low + 0.1), STEPS)
    even = np.linspace(0.0, 1.0, STEPS)
    ranks = np.searchsorted(np.sort(heights), edges) / max(len(heights), 1)
    ranks = (ranks - ranks[0]) / max(ranks[-1] - ranks[0], 1e-9)
    shares = EVENED * ranks + (1.0 - EVENED) * even
    shares /= shares[-1]
    return FuncNorm(
        (lambda h: np.interp(h, edges, shares), lambda s: np.interp(s, shares, edges)),
        vmin=float(edges[0]), vmax=float(edges[-1]),
    )  # fmt: skip


def _bar_ticks(norm: 'Normalize') -> list[float]:
    """Round heights that stand apart on a bar whose steps are not even."""
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 1.0)
    step = next(step for step in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1e3)
                if (high - low) / step <= 12)  # fmt: skip
    ticks: list[float] = []
    for height in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step:
        if not ticks or norm(height) - norm(ticks[-1]) > 0.055:
            ticks.append(float(round(height, 2)))
    return ticks


def _mark(axes: 'Axes', points: NDArray[np.float64]) -> tuple[float, float]:
    """Diameter in pixels and opacity that let ``points`` fill, but not flood, the axes."""
    width, height = axes_pixels(axes)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    inside = (points[:, 0] > left) & (points[:, 0] < right)
    inside &= (points[:, 1] > bottom) & (points[:, 1] < top)
    share = width * height / max(int(inside.sum()), 1)
    diameter = SNAPPED * float(np.clip(0.75 * np.sqrt(share), 1.6, 5.0))
    return diameter, float(np.clip(0.45 + 0.05 * share, 0.45, 0.9))


def _height_colours(look: Look) -> 'Colormap':
    """Viridis without the end that is lost on the ground of the picture, or without both."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    low, high = {LIGHT: (0.0, 0.92), DARK: (0.22, 1.0)}.get(look.theme, (0.2, 0.86))
    return ListedColormap(colormaps['viridis'](np.linspace(low, high, 256)))
