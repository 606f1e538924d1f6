"""Pictures of a trajectory and of a map from above; each function writes one PNG.

Matplotlib comes with the extra ``report`` and is imported when the first picture is drawn. Its
object interface keeps no global state, so pictures can be drawn from any thread.
"""

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import OutputError
from incremental_mapper.evaluation.trajectory_error import fit_rigid, match_truth
from incremental_mapper.geometry import transform_points
from incremental_mapper.trajectory import NANOSECONDS, Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

Rectangle: TypeAlias = tuple[float, float, float, float]

WIDTH_PX = 1600
HEIGHT_PX = 900
DPI = 100

# The palette of Okabe and Ito, which readers with any colour vision can tell apart.
BLUE = '#0072B2'
VERMILLION = '#D55E00'
GREEN = '#009E73'
PURPLE = '#CC79A7'
ORANGE = '#E69F00'
SKY = '#56B4E9'
INK = '#222222'
GREY = '#8A8A8A'

MAX_DRAWN_POINTS = 1_500_000
"""More points than this do not change a picture of this size; every k-th one is drawn."""


def draw_trajectory(
    path: Path,
    estimate: Trajectory,
    truth: Trajectory | None,
    fixes: NDArray[np.float64],
) -> None:
    """Draw the trajectory from above, over the truth and the GNSS positions that were used.

    ``fixes`` is (K, 3) metres in the map frame. The truth may have a map frame of its own: the
    part of it that the estimate covers is moved by the rigid transform that fits best. Raises
    OutputError where matplotlib is missing or the file cannot be written.
    """
    figure = new_figure()
    axes = figure.add_axes((0.06, 0.08, 0.92, 0.82))
    shown = [estimate.positions]
    if truth is not None:
        reference = _aligned_truth(estimate, truth)
        if len(reference) > 0:
            shown.append(reference)
            axes.plot(reference[:, 0], reference[:, 1], color='#BDBDBD', linewidth=7, label='truth')
    if len(fixes) > 0:
        axes.scatter(
            fixes[:, 0], fixes[:, 1], s=50, marker='x', color=VERMILLION, linewidths=1.8, zorder=5,
            label=f'GNSS positions used ({len(fixes)})',
        )  # fmt: skip
        shown.append(fixes)
    _draw_path(axes, estimate, BLUE, f'estimate ({len(estimate)} poses)', halo=0.0)
    _fill(axes, np.concatenate(shown), smallest=10.0)
    title(figure, 'Trajectory from above', _describe(estimate))
    _label_metres(axes)
    if len(estimate) > 0 or len(fixes) > 0:
        axes.legend(loc='best', frameon=True, framealpha=0.9, edgecolor='none', fontsize=11)
    save(figure, path)


def draw_map(path: Path, points: NDArray[np.floating], estimate: Trajectory) -> None:
    """Draw the map from above, coloured by height, with the trajectory over it.

    ``points`` is (N, 3) metres in the map frame. Raises OutputError like ``draw_trajectory``.
    """
    figure = new_figure()
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    axes = figure.add_axes((0.06, 0.08, 0.84, 0.82))
    drawn = np.asarray(points[:: max(1, -(-len(points) // MAX_DRAWN_POINTS))], dtype=np.float64)
    drawn = drawn[np.argsort(drawn[:, 2], kind='stable')]  # roofs hide the ground, not reversed
    # A few stray returns must neither shrink the street nor use up the colours.
    inner = np.percentile(drawn[:, :2], [0.5, 99.5], axis=0) if len(drawn) > 0 else drawn[:, :2]
    low, high = np.percentile(drawn[:, 2], [2.0, 98.0]) if len(drawn) > 0 else (0.0, 1.0)
    _fill(axes, np.concatenate([inner, estimate.positions[:, :2]]), smallest=10.0)
    size, alpha = _mark(axes, drawn)
    heights = Normalize(low, max(high, low + 0.1))
    axes.scatter(
        drawn[:, 0], drawn[:, 1], c=drawn[:, 2], s=size, alpha=alpha, linewidths=0, marker='o',
        cmap=_height_colours(), norm=heights,
    )  # fmt: skip
    _draw_path(axes, estimate, VERMILLION, 'trajectory', halo=5.0)
    bar = figure.colorbar(
        ScalarMappable(heights, _height_colours()), cax=figure.add_axes((0.915, 0.08, 0.014, 0.82)),
        extend='both', extendfrac=0.02,
    )  # fmt: skip
    bar.outline.set_edgecolor('#CCCCCC')
    bar.set_label('height in m', fontsize=12)
    _add_scale(axes)
    title(figure, 'Map from above', f'{len(points):,} points'.replace(',', ' '))
    _label_metres(axes)
    if len(estimate) > 0:
        axes.legend(loc='upper right', frameon=True, framealpha=0.9, edgecolor='none', fontsize=11)
    save(figure, path)


def new_figure() -> 'Figure':
    """An empty figure of the common size; raises OutputError where matplotlib is missing."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OutputError(
            "pictures need matplotlib; install it with: pip install 'incremental_mapper[report]'"
        ) from error
    figure = Figure(figsize=(WIDTH_PX / DPI, HEIGHT_PX / DPI), dpi=DPI, facecolor='white')
    FigureCanvasAgg(figure)
    return figure


def save(figure: 'Figure', path: Path) -> None:
    """Write the figure as PNG; raises OutputError where that fails."""
    try:
        figure.savefig(path, format='png', dpi=DPI)
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error


def title(figure: 'Figure', heading: str, facts: str) -> None:
    """A heading in the upper left corner, and what the picture shows behind it in grey."""
    left = figure.text(0.06, 0.945, heading, fontsize=17, fontweight='bold', color=INK)
    end = left.get_window_extent().x1 / WIDTH_PX
    figure.text(end + 0.012, 0.945, facts, fontsize=13, color='#666666')


def plain(axes: 'Axes') -> None:
    """Light frame and grid."""
    axes.set_axisbelow(True)
    axes.tick_params(colors='#555555', labelsize=11, length=3)
    for spine in axes.spines.values():
        spine.set_color('#CCCCCC')


def _aligned_truth(estimate: Trajectory, truth: Trajectory) -> NDArray[np.float64]:
    """True positions (M, 3) of the estimate's time span, moved into the estimate's map frame."""
    covered, reference = match_truth(estimate, truth)
    if len(covered) == 0:
        return np.zeros((0, 3))
    span = (truth.stamps >= covered.stamps[0]) & (truth.stamps <= covered.stamps[-1])
    positions = np.concatenate(
        [reference.positions[:1], truth.positions[span], reference.positions[-1:]]
    )
    return transform_points(fit_rigid(reference.positions, covered.positions), positions)


def _draw_path(axes: 'Axes', estimate: Trajectory, color: str, label: str, halo: float) -> None:
    """The poses joined by a line, upon a white one of width ``halo``; marks at both ends."""
    from matplotlib.patheffects import Normal, Stroke

    if len(estimate) == 0:
        return
    effects = [Stroke(linewidth=halo, foreground='white', alpha=0.85), Normal()]
    x, y = estimate.positions[:, 0], estimate.positions[:, 1]
    axes.plot(x, y, color=color, linewidth=2.2, label=label, path_effects=effects, zorder=4)
    for index, marker, name in ((0, 'o', 'start'), (-1, 's', 'end')):
        axes.scatter(
            x[index], y[index], s=110, marker=marker, color='white', edgecolors=color,
            linewidths=2.5, zorder=6, label=name,
        )  # fmt: skip


def _describe(estimate: Trajectory) -> str:
    if len(estimate) == 0:
        return 'no pose'
    length = float(np.linalg.norm(np.diff(estimate.positions, axis=0), axis=1).sum())
    seconds = (int(estimate.stamps[-1]) - int(estimate.stamps[0])) / NANOSECONDS
    return f'{length:.1f} m in {seconds:.1f} s'


def _fill(axes: 'Axes', shown: NDArray[np.float64], smallest: float) -> None:
    """Set limits that hold ``shown`` (N, 2 or 3), fill the axes and have one scale in x and y."""
    low, high = np.zeros(2), np.zeros(2)
    if len(shown) > 0:
        low, high = shown[:, :2].min(axis=0), shown[:, :2].max(axis=0)
    box = axes.get_position()
    ratio = (box.width * WIDTH_PX) / (box.height * HEIGHT_PX)
    extent = np.maximum(high - low, smallest) * 1.08
    extent = np.array([max(extent[0], extent[1] * ratio), max(extent[1], extent[0] / ratio)])
    centre = (low + high) / 2
    axes.set_xlim(centre[0] - extent[0] / 2, centre[0] + extent[0] / 2)
    axes.set_ylim(centre[1] - extent[1] / 2, centre[1] + extent[1] / 2)
    axes.set_aspect('equal', adjustable='box')


def _mark(axes: 'Axes', points: NDArray[np.float64]) -> tuple[float, float]:
    """Area in square points and opacity that let ``points`` fill, but not flood, the axes."""
    box = axes.get_position()
    pixels = box.width * WIDTH_PX * box.height * HEIGHT_PX
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    inside = (points[:, 0] > left) & (points[:, 0] < right)
    inside &= (points[:, 1] > bottom) & (points[:, 1] < top)
    share = pixels / max(int(inside.sum()), 1)
    diameter = float(np.clip(0.75 * np.sqrt(share), 1.6, 5.0)) * 72 / DPI
    return diameter**2, float(np.clip(0.45 + 0.05 * share, 0.45, 0.9))


def _height_colours() -> 'Colormap':
    """Viridis without its palest end, which is lost on white."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps['viridis'](np.linspace(0.0, 0.92, 256)))


def _add_scale(axes: 'Axes') -> None:
    """A bar of a round length, about a sixth of the picture wide."""
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    left, right = axes.get_xlim()
    longest = (right - left) / 6
    power = 10.0 ** np.floor(np.log10(longest))
    length = float(max(step * power for step in (1, 2, 5) if step * power <= longest))
    bar = AnchoredSizeBar(
        axes.transData, length, f'{length:g} m', 'lower left', pad=0.5, borderpad=0.8, sep=5,
        size_vertical=(right - left) * 0.002, color=INK,
    )  # fmt: skip
    bar.patch.set(alpha=0.85, edgecolor='none')
    axes.add_artist(bar)


def _label_metres(axes: 'Axes') -> None:
    plain(axes)
    axes.grid(color='#E6E6E6', linewidth=0.8)
    axes.set_xlabel('x in m', fontsize=12)
    axes.set_ylabel('y in m', fontsize=12)
