"""Pictures of a trajectory and of a map, from above and from the side."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from incremental_mapper.geometry import transform_points
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory, fit_rigid, match_truth
from incremental_mapper.visualization.figure import (
    WHOLE,
    Look,
    add_legend,
    axes_pixels,
    box,
    new_figure,
    plain,
    save,
    title,
)
from incremental_mapper.visualization.height_points import draw_points, sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DRAWN_POINTS_A_PIXEL = 1
"""More points than this do not change a picture; every k-th one is drawn."""
WIDE = Look(height=600)
"""The look of a map from the side."""
SMALLEST = 10.0
"""Metres that a picture of a map shows at least."""
SMALLEST_PATH = 0.6
"""Metres that a picture of a trajectory shows at least: a standing car's fixes are worth a look."""
AT_REST = 0.5
"""Metres; a vehicle whose poses all lie within so much of each other has not driven."""
FLATTEST, TALLEST = 0.375, 0.75
"""Heights of pictures, in their widths, between which they take the shape of what they show."""
NARROWEST = 0.55
"""Of its width that a picture keeps where what it shows is taller than that."""
NO_BAR, BAR = (128, 76), (256, 142)
"""Pixels beside the axes, with a heading and without; and where a bar of colours stands there."""
HEADED, UNHEADED = 166, 84
"""Pixels above and below the axes, with a heading and without."""
SQUARE, MOST_SQUARES = 0.5, 4_000_000
"""Metres of the squares in which all points have the same pose next to them; larger ones where
there would be more than so many."""
NO_CLOSURES: NDArray[np.float64] = np.zeros((0, 2, 3))


def draw_trajectory(
    path: Path,
    estimate: Trajectory,
    truth: Trajectory | None,
    fixes: NDArray[np.float64],
    look: Look = WHOLE,
    georeferenced: bool = False,
    closures: NDArray[np.float64] = NO_CLOSURES,
) -> None:
    """Draw the trajectory from above, over the truth and the GNSS positions that were used.

    Args:
        path: A PNG, SVG or PDF, as the suffix says.
        estimate: T_map_base.
        truth: True poses. They may have a map frame of their own: the part that the estimate
            covers is moved by the rigid transform that fits best.
        fixes: Antenna positions (K, 3) in metres, in the map frame of the estimate.
        look: Colours and width; the height follows what is shown.
        georeferenced: Whether x is east and y north.
        closures: Positions (K, 2, 3) of the poses that saw the same place, metres in the map.

    Raises:
        OutputError: matplotlib is missing, or the file cannot be written.
    """
    save(trajectory_figure(estimate, truth, fixes, look, georeferenced, closures), path)


def draw_map(
    path: Path,
    points: NDArray[np.floating],
    estimate: Trajectory,
    look: Look = WHOLE,
    georeferenced: bool = False,
    count: int | None = None,
) -> None:
    """Draw the map from above, coloured by height over the way, with the trajectory over it.

    Args:
        path: A PNG, SVG or PDF, as the suffix says.
        points: The map (N, 3) in metres, in the map frame.
        estimate: T_map_base.
        look: Colours and width; the height follows what is shown.
        georeferenced: Whether x is east and y north.
        count: How many points the map has; None where these are all.

    Raises:
        OutputError: matplotlib is missing, or the file cannot be written.
    """
    save(map_figure(points, estimate, look, georeferenced, count), path)


def draw_map_side(
    path: Path,
    points: NDArray[np.floating],
    estimate: Trajectory,
    look: Look = WIDE,
    georeferenced: bool = False,
) -> None:
    """Draw the map from the side, across the main direction of the drive; see ``draw_map``."""
    save(side_figure(points, estimate, look, georeferenced), path)


def trajectory_figure(
    estimate: Trajectory,
    truth: Trajectory | None,
    fixes: NDArray[np.float64],
    look: Look,
    georeferenced: bool = False,
    closures: NDArray[np.float64] = NO_CLOSURES,
) -> 'Figure':
    """The figure that ``draw_trajectory`` saves."""
    reference = np.zeros((0, 3)) if truth is None else _aligned_truth(estimate, truth)
    shown = np.concatenate([estimate.positions, reference, fixes.reshape(-1, 3)])[:, :2]
    look = _fitted(look, shown, SMALLEST_PATH, NO_BAR)
    theme, figure = look.theme, new_figure(look)
    axes = figure.add_axes(_place(look))
    if len(reference) > 0:
        axes.plot(
            reference[:, 0], reference[:, 1], color=theme.truth, linewidth=7, label='truth',
            solid_capstyle='butt',
        )  # fmt: skip
    if len(fixes) > 0:
        axes.scatter(
            fixes[:, 0], fixes[:, 1], s=50, marker='x', color=theme.vermillion, linewidths=1.8,
            zorder=5, label=f'fixes used ({len(fixes)})',
        )  # fmt: skip
    for number, (first, second) in enumerate(closures):
        label = '' if number else f'loops ({len(closures)})'
        ends = [first[0], second[0]], [first[1], second[1]]
        axes.plot(*ends, color=theme.purple, linewidth=1.8, zorder=3, label=label)
    label = f'estimate ({len(estimate)} poses)'
    _draw_path(axes, estimate.positions, look, theme.blue, label, halo=0.0)
    _fill(axes, shown, SMALLEST_PATH)
    title(figure, 'Trajectory from above', _describe(estimate, fixes), look)
    _label(axes, look, *_plane(georeferenced))
    if len(estimate) > 0 or len(fixes) > 0:
        add_legend(axes, look)
    return figure


def map_figure(
    points: NDArray[np.floating],
    estimate: Trajectory,
    look: Look,
    georeferenced: bool = False,
    count: int | None = None,
) -> 'Figure':
    """The figure that ``draw_map`` saves."""
    count = len(points) if count is None else count
    drawn = drawn_points(points, look).astype(np.float64)
    shown = np.concatenate([_inner_part(drawn[:, :2], 0.5), estimate.positions[:, :2]])
    look = _fitted(look, shown, SMALLEST, BAR)
    figure = new_figure(look)
    axes = figure.add_axes(_place(look, bar=True))
    _fill(axes, shown, SMALLEST)
    draw_points(axes, drawn[:, :2], _above_way(drawn, estimate), look)
    _draw_path(axes, estimate.positions, look, look.theme.vermillion, 'trajectory', halo=5.0)
    _add_scale(axes, look)
    title(figure, 'Map from above', f'{count:,} points'.replace(',', ' '), look)
    _label(axes, look, *_plane(georeferenced))
    if len(estimate) > 0:
        add_legend(axes, look)
    return figure


def side_figure(
    points: NDArray[np.floating], estimate: Trajectory, look: Look, georeferenced: bool = False
) -> 'Figure':
    """The figure that ``draw_map_side`` saves."""
    figure = new_figure(look)
    axes = figure.add_axes(_place(look, bar=True))
    drawn = drawn_points(points, look).astype(np.float64)
    along = _main_direction(estimate.positions if len(estimate) > 1 else drawn)
    flat = np.stack([drawn[:, :2] @ along, drawn[:, 2]], axis=1)
    path = np.stack([estimate.positions[:, :2] @ along, estimate.positions[:, 2]], axis=1)
    stretch = _fill_stretched(axes, np.concatenate([_inner_part(flat, 0.2), path]))
    draw_points(axes, flat, _above_way(drawn, estimate), look)
    _draw_path(axes, path, look, look.theme.vermillion, 'trajectory', halo=5.0)
    turn = np.degrees(np.arctan2(along[1], along[0]))
    towards = f'{round(90.0 - turn) % 360}° from north' if georeferenced else f'{turn:.0f}° from x'
    facts = f'projected onto a line at {towards}'
    if stretch > 1:
        facts += f', heights drawn {stretch} times as large'
    title(figure, 'Map from the side', facts, look)
    times = f' (drawn {stretch}×)' if stretch > 1 else ''
    height = 'height in the map, m' if georeferenced else 'z, m'
    _label(axes, look, f'projected onto a line at {towards}, m', f'{height}{times}')
    return figure


def drawn_points(points: NDArray[np.floating], look: Look = WHOLE) -> NDArray[np.floating]:
    """As many points as a picture shows: every k-th of (N, C), in their order."""
    most = DRAWN_POINTS_A_PIXEL * look.width * look.height
    return points[:: max(1, -(-len(points) // most))]


def _plane(georeferenced: bool) -> tuple[str, str]:
    """What the axes of a picture from above are."""
    return ('east, m', 'north, m') if georeferenced else ('x, m', 'y, m')


def _above_way(points: NDArray[np.float64], estimate: Trajectory) -> NDArray[np.float64]:
    """Heights (N,) over the nearest pose, metres: a street that climbs keeps its colour."""
    heights: NDArray[np.float64] = points[:, 2]
    if len(estimate) == 0 or len(points) == 0:
        return heights
    # A square has far more points than one, and one nearest pose.
    low = np.array([points[:, 0].min(), points[:, 1].min()])
    extent = np.array([points[:, 0].max(), points[:, 1].max()]) - low
    side = max(SQUARE, np.sqrt(extent.prod() / MOST_SQUARES), extent.max() / MOST_SQUARES)
    column, row = (((points[:, k] - low[k]) / side).astype(np.int64) for k in range(2))
    rows = int(row.max()) + 1
    numbers = column * rows + row
    taken = np.flatnonzero(np.bincount(numbers))
    middles = low + (np.stack(np.divmod(taken, rows), axis=1) + 0.5) * side
    _, nearest = cKDTree(estimate.positions[:, :2]).query(middles)
    below = np.zeros(int(taken[-1]) + 1)
    below[taken] = estimate.positions[nearest, 2]
    return np.asarray(heights - below[numbers], dtype=np.float64)


def _fitted(
    look: Look, shown: NDArray[np.float64], smallest: float, sides: tuple[int, int]
) -> Look:
    """The look with the height that what is shown (N, 2) asks for, within limits.

    ``sides`` are the pixels beside the axes, with a heading and without.
    """
    extent = _extent(shown, smallest)[1]
    beside = sides[0] if look.heading else sides[1]
    above = HEADED if look.heading else UNHEADED
    wanted = (look.width - beside) * extent[1] / extent[0] + above
    height = float(np.clip(wanted, FLATTEST * look.width, TALLEST * look.width))
    # What is taller still gets a narrower picture, rather than two white sides.
    width = float((height - above) * extent[0] / extent[1] + beside)
    if not look.heading:  # a page gives all its pictures the same width
        width = look.width
    return replace(
        look,
        width=round(float(np.clip(width, NARROWEST * look.width, look.width))),
        height=round(height),
    )


def _place(look: Look, bar: bool = False) -> tuple[float, float, float, float]:
    beside = (BAR if bar else NO_BAR)[0 if look.heading else 1]
    if look.heading:
        return box(look, 96, 72, beside - 96, HEADED - 72)
    return box(look, 62, 52, beside - 62, UNHEADED - 52)


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


def _inner_part(flat: NDArray[np.float64], outside: float) -> NDArray[np.float64]:
    """Corners (2, 2) of what holds points (N, 2) but for ``outside`` percent on every side.

    A few stray returns must not shrink the street.
    """
    some = sample(flat)
    return np.percentile(some, [outside, 100.0 - outside], axis=0) if len(some) > 0 else some


def _main_direction(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vector (2,) along which positions (N, 3) spread most, towards the last of them."""
    if len(positions) < 2:
        return np.array([1.0, 0.0])
    flat = positions[:, :2] - positions[:, :2].mean(axis=0)
    along: NDArray[np.float64] = np.linalg.svd(flat, full_matrices=False)[2][0]
    return along if (flat[-1] - flat[0]) @ along >= 0 else -along


def _draw_path(
    axes: 'Axes', positions: NDArray[np.float64], look: Look, color: str, label: str, halo: float
) -> None:
    """Positions joined by a line, upon one of width ``halo`` as the ground; marks at both ends."""
    from matplotlib.patheffects import Normal, Stroke

    if len(positions) == 0:
        return
    ground = look.theme.ground
    effects = [Stroke(linewidth=halo, foreground=ground, alpha=0.85), Normal()] if halo else None
    x, y = positions[:, 0], positions[:, 1]
    axes.plot(x, y, color=color, linewidth=2.2, label=label, path_effects=effects, zorder=4)
    for index, marker, name in ((0, 'o', 'start'), (-1, 's', 'end')):
        axes.scatter(
            x[index], y[index], s=look.text**2 * 0.75, marker=marker, color=ground,
            edgecolors=color, linewidths=2.5, zorder=6, label=name,
        )  # fmt: skip


def _describe(estimate: Trajectory, fixes: NDArray[np.float64]) -> str:
    if len(estimate) == 0:
        return 'no pose'
    spread = _spread(estimate.positions)
    if spread < AT_REST:
        near = f', {len(fixes)} fixes within {_spread(fixes):.3f} m' if len(fixes) > 0 else ''
        return f'at rest: {len(estimate)} poses within {spread:.3f} m{near}'
    length = float(np.linalg.norm(np.diff(estimate.positions, axis=0), axis=1).sum())
    seconds = (int(estimate.stamps[-1]) - int(estimate.stamps[0])) / NANOSECONDS
    return f'{length:.1f} m in {seconds:.1f} s'


def _spread(positions: NDArray[np.float64]) -> float:
    """Length of the diagonal of the box, in the plane, that positions (N, 3) lie in."""
    return float(np.linalg.norm(np.ptp(positions[:, :2], axis=0)))


def _extent(
    shown: NDArray[np.float64], smallest: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Middle and size (2,) of a picture that holds ``shown`` (N, 2) with a margin."""
    low, high = np.zeros(2), np.zeros(2)
    if len(shown) > 0:
        low, high = shown.min(axis=0), shown.max(axis=0)
    return (low + high) / 2, np.maximum(high - low, smallest) * 1.08


def _fill(axes: 'Axes', shown: NDArray[np.float64], smallest: float) -> None:
    """Set limits that hold ``shown`` (N, 2), fill the axes and have one scale in x and y."""
    centre, extent = _extent(shown, smallest)
    width, height = axes_pixels(axes)
    ratio = width / height
    extent = np.array([max(extent[0], extent[1] * ratio), max(extent[1], extent[0] / ratio)])
    axes.set_xlim(centre[0] - extent[0] / 2, centre[0] + extent[0] / 2)
    axes.set_ylim(centre[1] - extent[1] / 2, centre[1] + extent[1] / 2)
    axes.set_aspect('equal', adjustable='box')


def _fill_stretched(axes: 'Axes', shown: NDArray[np.float64]) -> int:
    """As ``_fill``, with heights drawn larger where a long drive would be a mere line.

    Returns how many times as large.
    """
    low, high = np.zeros(2), np.zeros(2)
    if len(shown) > 0:
        low, high = shown.min(axis=0), shown.max(axis=0)
    width, height = axes_pixels(axes)
    extent = np.maximum(high - low, [SMALLEST, 2.0]) * [1.02, 1.1]
    room = height / width * extent[0] / extent[1]
    stretch = max((times for times in (1, 2, 3, 5, 10, 20, 50) if times <= room), default=1)
    scale = max(extent[0] / width, extent[1] / height * stretch)
    axes.set_xlim(*((low[0] + high[0]) / 2 + np.array([-0.5, 0.5]) * scale * width))
    axes.set_ylim(*((low[1] + high[1]) / 2 + np.array([-0.5, 0.5]) * scale * height / stretch))
    return stretch


def _add_scale(axes: 'Axes', look: Look) -> None:
    """A bar of a round length, about a sixth of the picture wide."""
    from matplotlib.offsetbox import AnchoredOffsetbox, AuxTransformBox, TextArea, VPacker
    from matplotlib.patches import Rectangle

    left, right = axes.get_xlim()
    longest = (right - left) / 6
    power = 10.0 ** np.floor(np.log10(longest))
    length = float(max(step * power for step in (1, 2, 5) if step * power <= longest))
    bar = AuxTransformBox(axes.transData)
    bar.add_artist(
        Rectangle((0, 0), length, (right - left) * 0.002, linewidth=0, color=look.theme.ink)
    )
    text = TextArea(f'{length:g} m', textprops={'color': look.theme.ink, 'size': look.text - 1})
    scale = AnchoredOffsetbox(
        'lower left', pad=0.5, borderpad=0.8,
        child=VPacker(children=[bar, text], align='center', pad=0, sep=5),
    )  # fmt: skip
    scale.patch.set(alpha=0.85, edgecolor='none', facecolor=look.theme.ground)
    axes.add_artist(scale)


def _label(axes: 'Axes', look: Look, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    plain(axes, look)
    axes.grid(color=look.theme.grid, linewidth=0.8)
