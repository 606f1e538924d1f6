"""Compression, score and error over the time of a drive, one above the other."""

from collections import Counter
from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

from incremental_mapper.evaluation.table import BASE
from incremental_mapper.geometry import transform_points
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.scoring.score_names import SCORE_NAMES
from incremental_mapper.trajectory import Trajectory, fit_rigid, match_truth
from incremental_mapper.visualization.figure import Look, Theme, box, new_figure, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Series: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Seconds since the first cluster (N,), and a number at each (N,)."""

SETTLED = 20
"""Compression is drawn from so many variables of base on: before, each one is a jump."""
MIN_TRUE_POSES = 3
WIDE = 4.0
"""Ratio of errors from which on their axis is logarithmic."""
ALONG = 30
"""Points of a stretch of a line where no label may be."""
SQUEEZED = 0.35
"""Share of both axes up to which strategies lie so close together, seen from base, that base is
told at the rim of their chart."""


def progress_figure(
    runs: Mapping[str, FinishedRun],
    lead: str,
    truth: Trajectory | None,
    names: tuple[str, ...],
    look: Look,
) -> tuple['Figure', str]:
    """The figure, and what a caption must say of it.

    ``runs`` are a drive's runs by strategy; ``names`` are all strategies, whose order gives the
    colours. Scores are those of ``lead``, because those of two strategies cannot be compared.
    """
    start = min(run.first_stamp for run in runs.values())
    colours = strategy_colours(names, look.theme)
    savings, what = _savings(runs)
    label, scores = _scores(runs[lead])
    errors = {} if truth is None else _errors(runs, truth)
    panels: list[tuple[str, dict[str, Series]]] = []
    if savings:
        panels.append((f'{what} saved so far, %', savings))
    if label:
        said = SCORE_NAMES.get(label, label)
        panels.append((f'score of the winners of {lead}: {said}', {lead: scores}))
    if errors:
        panels.append(('distance to the truth, cm', errors))
    figure = new_figure(look)
    if not panels:
        return figure, ''
    end = max(run.last_stamp for run in runs.values())
    left, bottom, width, height = box(look, 62, 50, 14, 26)
    gap = 30 / look.height
    each = (height - gap * (len(panels) - 1)) / len(panels)
    for index, (title, lines) in enumerate(panels):
        low = bottom + (len(panels) - 1 - index) * (each + gap)
        axes = figure.add_axes((left, low, width, each))
        for name, (seconds, numbers) in lines.items():
            axes.plot(seconds, numbers, color=colours[name], linewidth=1.7, label=name)
        axes.set_xlim(0.0, max((end - start) / NANOSECONDS, 0.1))
        _tidy(axes, title, look, last=index == len(panels) - 1)
    caption = 'Over time: '
    caption += ', '.join(
        text
        for text, shown in (
            (f'{what} saved against base', bool(savings)),
            (f'score of the winners of {lead} (lower is better)', bool(label)),
            ('distance to the truth after the best rigid fit', bool(errors)),
        )
        if shown
    )
    return figure, f'{caption}.'


def trade_figure(points: Mapping[str, tuple[float, float]], look: Look) -> 'Figure':
    """What the strategies save against what it costs, a point each.

    Where base is so far off that the others would lie on one spot, the chart is theirs, and base is
    told at its rim.

    Args:
        points: RPE per second, cm, and variables saved, %, by label. Labels of one strategy with
            several confidences, NAME@X, are joined by a line.
        look: Size and colours.
    """
    figure = new_figure(look)
    axes = figure.add_axes(box(look, 62, 50, 14, 26))
    names = tuple(dict.fromkeys(label.partition('@')[0] for label in points))
    colours = strategy_colours(names, look.theme)
    aside = {BASE: points[BASE]} if _squeezed(points) else {}
    points = {label: point for label, point in points.items() if label not in aside}
    sweeps: dict[str, list[tuple[float, tuple[float, float]]]] = {}
    for label, point in points.items():
        name, mark, confidence = label.partition('@')
        axes.plot(*point, 'o', color=colours[name], markersize=7)
        if mark:
            sweeps.setdefault(name, []).append((float(confidence), point))
    for name, sweep in sweeps.items():
        line = np.array([point for _, point in sorted(sweep)])
        axes.plot(line[:, 0], line[:, 1], color=colours[name], linewidth=1.7, zorder=1)
    errors = [error for error, _ in points.values()]
    if min(errors) > 0.0 and max(errors) > WIDE * min(errors):
        axes.set_xscale('log')
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.margins(0.15)
    _tidy(axes, 'variables saved, %', look, last=True)
    axes.set_xlabel('RPE per second, cm: further left is better')
    _label(axes, points, look)
    for label, point in aside.items():
        _at_the_rim(axes, f'{label}: {point[0]:.2g} cm, {point[1]:.0f} %', point, look)
    return figure


def _squeezed(points: Mapping[str, tuple[float, float]]) -> bool:
    """Whether base is so far from all others that their differences would not be seen."""
    others = np.array([point for label, point in points.items() if label != BASE])
    if BASE not in points or len(others) < 2:
        return False
    whole = np.ptp(np.vstack([others, points[BASE]]), axis=0)
    return bool((np.ptp(others, axis=0) < SQUEEZED * whole).all())


def _at_the_rim(axes: 'Axes', text: str, point: tuple[float, float], look: Look) -> None:
    """Write in the corner on whose side a point lies that is not shown, with an arrow to it."""
    shown = axes.transData.inverted().transform(axes.transAxes.transform((0.5, 0.5)))
    right, up = point[0] > shown[0], point[1] > shown[1]
    axes.annotate(
        text,
        (0.99 if right else 0.01, 0.98 if up else 0.02),
        (-26 if right else 26, -16 if up else 16),
        xycoords='axes fraction',
        textcoords='offset points',
        ha='right' if right else 'left',
        va='center',
        fontsize=look.text,
        color=look.theme.ink,
        arrowprops={'arrowstyle': '->', 'color': look.theme.grey},
    )


def _label(axes: 'Axes', points: Mapping[str, tuple[float, float]], look: Look) -> None:
    """Write each label beside its point, where no other label, no point and no line is."""
    axes.get_xlim(), axes.get_ylim()  # what it shows is settled when it is asked for
    spots = {label: axes.transData.transform(point) for label, point in points.items()}
    pixel = axes.figure.dpi / 72.0
    covered = [axes.transData.transform(line.get_xydata()) for line in axes.lines]
    shares = np.linspace(0.0, 1.0, ALONG)[:, None]
    taken = [
        (x - 5 * pixel, y - 5 * pixel, x + 5 * pixel, y + 5 * pixel)
        for ends in covered
        for start, end in zip(ends, np.vstack([ends[1:], ends[-1:]]), strict=True)
        for x, y in start + shares * (end - start)
    ]
    frame = axes.bbox
    for label, (x, y) in spots.items():
        wide, high = 0.62 * look.text * len(label) * pixel, look.text * pixel
        places = []
        for up in (0, 1, -1, 2, -2):
            for right in (True, False):
                left = x + 9 * pixel if right else x - 9 * pixel - wide
                low = y + (up - 0.5) * 1.2 * high
                spot = (left, low, left + wide, low + high)
                inside = frame.x0 <= left and left + wide <= frame.x1 and frame.y0 <= low
                places.append((not inside, any(_meet(spot, other) for other in taken), spot, right))
        *_, spot, right = min(places, key=lambda place: place[:2])
        taken.append(spot)
        side = spot[0] - x if right else spot[2] - x
        axes.annotate(
            label,
            points[label],
            (side / pixel, (spot[1] - y) / pixel),
            textcoords='offset points',
            ha='left' if right else 'right',
            fontsize=look.text,
            color=look.theme.ink,
        )


def _meet(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    apart = one[0] > other[2] or other[0] > one[2] or one[1] > other[3] or other[1] > one[3]
    return not apart


def strategy_colours(names: tuple[str, ...], theme: Theme) -> dict[str, str]:
    """A colour for each strategy; base is grey."""
    palette = (theme.blue, theme.vermillion, theme.green, theme.purple, theme.orange, theme.sky)
    others = [name for name in names if name != BASE]
    colours = {name: palette[index % len(palette)] for index, name in enumerate(others)}
    return colours | {BASE: theme.grey}


def _savings(runs: Mapping[str, FinishedRun]) -> tuple[dict[str, Series], str]:
    """Percent saved so far, by strategy, and what of.

    Variables are compared with those of the base run. Without one, clusters are compared with
    the measurements of different stamps, each of which base would give a cluster.
    """
    if BASE in runs:
        base = _stamps(runs[BASE], 'variables')
        found = {
            name: _saved(_stamps(run, 'variables'), base, run.first_stamp)
            for name, run in runs.items()
            if name != BASE
        }
        return found, 'variables'
    found = {}
    for name, run in runs.items():
        members = {m['stamp_ns'] for item in run.graph['clusters'] for m in item['members']}
        elements = np.array(sorted(members), dtype=np.int64)
        found[name] = _saved(_stamps(run, 'clusters'), elements, run.first_stamp)
    return found, 'clusters'


def _stamps(run: FinishedRun, what: str) -> NDArray[np.int64]:
    return np.array(sorted(item['stamp_ns'] for item in run.graph[what]), dtype=np.int64)


def _saved(own: NDArray[np.int64], base: NDArray[np.int64], start: int) -> Series:
    """Percent that ``own`` is fewer than ``base`` up to each time of ``base``."""
    times = np.unique(base)
    before = np.searchsorted(base, times, side='right')
    times, before = times[before >= SETTLED], before[before >= SETTLED]
    kept = np.searchsorted(own, times, side='right')
    return (times - start) / NANOSECONDS, 100.0 * (1.0 - kept / np.maximum(before, 1))


def _scores(run: FinishedRun) -> tuple[str, Series]:
    """The name of the commonest score of the winners, and its values."""
    rows = [row for row in run.windows if row['score']]
    names = Counter(row['score_name'] for row in rows)
    if not names:
        return '', (np.zeros(0), np.zeros(0))
    name = names.most_common(1)[0][0]
    chosen = [row for row in rows if row['score_name'] == name]
    seconds = [run.seconds((int(row['start_ns']) + int(row['end_ns'])) // 2) for row in chosen]
    return name, (np.array(seconds), np.array([float(row['score']) for row in chosen]))


def _errors(runs: Mapping[str, FinishedRun], truth: Trajectory) -> dict[str, Series]:
    """Centimetres between estimate and truth after the best rigid fit, by strategy."""
    found = {}
    for name, run in runs.items():
        covered, reference = match_truth(run.trajectory, truth)
        if len(covered) < MIN_TRUE_POSES:
            continue
        fit = fit_rigid(covered.positions, reference.positions)
        apart = transform_points(fit, covered.positions) - reference.positions
        seconds = (covered.stamps - run.first_stamp) / NANOSECONDS
        found[name] = (seconds, 100.0 * np.linalg.norm(apart, axis=1))
    return found


def _tidy(axes: 'Axes', title: str, look: Look, last: bool) -> None:
    axes.set_title(title, loc='left', fontsize=look.text, color=look.theme.ink, pad=4)
    if last:
        axes.set_xlabel('seconds since the first cluster')
    plain(axes, look)
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.grid(color=look.theme.grid, linewidth=0.8)
    axes.tick_params(labelbottom=last)
    axes.margins(y=0.12)
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)
