"""Points of a map, coloured by how high they lie over the way."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.visualization.figure import DARK, DPI, LIGHT, Look, axes_pixels

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

    norm, colours = _evened(heights), _height_colours(look)
    size, alpha = _mark(axes, flat)
    # Markers are put onto whole pixels: what stands on a grid itself would show a weave.
    pixel = np.ptp([axes.get_xlim(), axes.get_ylim()], axis=1) / axes_pixels(axes)
    flat = flat + pixel * np.random.default_rng(0).uniform(-0.5, 0.5, flat.shape)
    # One line of markers for each colour: points with a colour each take ten times as long.
    shades = (np.asarray(norm(heights)).clip(0.0, 1.0) * SHADES).astype(int).clip(max=SHADES - 1)
    order = np.argsort(shades, kind='stable')  # what is high hides what is low
    for part in np.split(order, np.searchsorted(shades[order], np.arange(1, SHADES))):
        if len(part) > 0:
            axes.plot(
                flat[part, 0], flat[part, 1], linestyle='', marker='o', alpha=alpha,
                markeredgewidth=0, color=colours((shades[part[0]] + 0.5) / SHADES),
                markersize=SNAPPED * np.sqrt(size), rasterized=True,
            )  # fmt: skip
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


def _evened(heights: NDArray[np.float64]) -> 'Normalize':
    """Colours for heights (N,): partly by rank, so that a few tall houses leave some for streets.

    By rank alone a flat road would have all colours for its last centimetres.
    """
    from matplotlib.colors import FuncNorm

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
    """Area in square points and opacity that let ``points`` fill, but not flood, the axes."""
    width, height = axes_pixels(axes)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    inside = (points[:, 0] > left) & (points[:, 0] < right)
    inside &= (points[:, 1] > bottom) & (points[:, 1] < top)
    share = width * height / max(int(inside.sum()), 1)
    diameter = float(np.clip(0.75 * np.sqrt(share), 1.6, 5.0)) * 72 / DPI
    return diameter**2, float(np.clip(0.45 + 0.05 * share, 0.45, 0.9))


def _height_colours(look: Look) -> 'Colormap':
    """Viridis without the end that is lost on the ground of the picture, or without both."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    low, high = {LIGHT: (0.0, 0.92), DARK: (0.22, 1.0)}.get(look.theme, (0.2, 0.86))
    return ListedColormap(colormaps['viridis'](np.linspace(low, high, 256)))
