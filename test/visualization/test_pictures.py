import re
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from incremental_mapper.errors import OutputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization import pictures
from incremental_mapper.visualization.figure import (
    DARK,
    LIGHT,
    PAGE,
    WIDTH_PX,
    Look,
    axes_pixels,
    svg_for_page,
)
from incremental_mapper.visualization.graph_legend import LOOSE
from incremental_mapper.visualization.graph_picture import draw_graph, graph_figure
from incremental_mapper.visualization.graph_view import (
    closure_ends,
    typical_stretch,
    unconnected_variables,
)
from incremental_mapper.visualization.pictures import (
    WIDE,
    draw_map,
    draw_map_side,
    draw_trajectory,
    map_figure,
    side_figure,
    trajectory_figure,
)

REASON = 'matplotlib is not installed; pictures need the extra "report"'
image = pytest.importorskip('matplotlib.image', reason=REASON)

START = 1_544_590_798_000_000_000
NO_POSES = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
NO_FIXES = np.zeros((0, 3))


def drive(count: int = 50) -> Trajectory:
    stamps = START + np.arange(count, dtype=np.int64) * NANOSECONDS // 10
    x = np.linspace(0.0, 40.0, count)
    return Trajectory(
        stamps,
        np.c_[x, 3.0 * np.sin(x / 10.0), np.zeros(count)],
        np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
    )


@pytest.mark.parametrize('size', [1.0, 1000.0])
def test_heights_are_over_the_nearest_pose(size):
    way = drive()
    climbing = replace(way, positions=size * np.c_[way.positions[:, :2], way.positions[:, 0] / 10])
    around = np.random.default_rng(1).uniform(-5.0, 45.0, (5000, 3)) * size
    apart = np.linalg.norm(around[:, None, :2] - climbing.positions[None, :, :2], axis=2)
    exact = around[:, 2] - climbing.positions[apart.argmin(axis=1), 2]
    # A square of half a metre in 50, or one in 2000, and what the way climbs from pose to pose.
    assert np.abs(pictures._above_way(around, climbing) - exact).max() < size * (0.05 + 0.09)
    single = around[:1]
    assert pictures._above_way(single, climbing).shape == (1,)


@pytest.mark.parametrize('width', range(WIDTH_PX // 2, WIDTH_PX + 1, 80))
def test_the_legend_of_a_graph_lies_within_the_picture(width):
    graph = two_chains()
    kinds = 'imu', 'gnss', 'prior_pose', *LOOSE
    plain = {**graph['factors'][0], 'sensor': None}
    graph['factors'] += [{**plain, 'kind': kind} for kind in kinds]
    figure, _ = graph_figure(graph, START, START + NANOSECONDS, Look(width=width))
    (legend,) = figure.legends
    assert len(legend.get_texts()) > 5
    extent = legend.get_window_extent()
    assert extent.x0 >= 0 and extent.x1 <= width


def test_loops_that_are_closed_are_drawn_between_their_poses():
    graph = two_chains()
    keys = [item['key'] for item in graph['variables'] if item['kind'] == 'pose']
    for place, item in enumerate(graph['variables']):
        item['value'] = [float(place), 0.5 * place, 0.0, 0.0, 0.0, 0.0, 1.0]
    graph['factors'].append(
        {'kind': 'closure', 'variables': [keys[0], keys[-1]], 'sensor': None, 'stamps_ns': [0, 1]}
    )
    ends = closure_ends(graph)
    assert ends.shape == (1, 2, 3) and ends[0, 0].tolist() == [0.0, 0.0, 0.0]
    figure = trajectory_figure(drive(), None, NO_FIXES, Look(), closures=ends)
    (line,) = [one for one in figure.axes[0].lines if one.get_label() == 'loops (1)']
    assert line.get_xydata().tolist() == ends[0, :, :2].tolist()
    # In the picture of a stretch of the graph its other end lies outside.
    start = min(item['stamp_ns'] for item in graph['clusters'])
    part, _ = graph_figure(graph, start, start + NANOSECONDS // 2, Look(), start)
    assert part.axes[0].get_xlim() == pytest.approx((0.0, 0.5))
    assert 'closure' in [text.get_text() for text in part.legends[0].get_texts()]


def street(count: int = 5000) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.uniform([0.0, -8.0, 0.0], [40.0, 8.0, 6.0], (count, 3)).astype(np.float32)


def two_chains(clusters: int = 30) -> dict[str, Any]:
    """Two LiDARs that take turns, a fix in every fifth cluster, an IMU factor to every second."""
    graph: dict[str, Any] = {
        'format': 1, 'frame': 'map', 'variables': [], 'clusters': [], 'factors': [],
    }  # fmt: skip

    def factor(kind: str, variables: list[str], sensor: str | None = None) -> None:
        graph['factors'].append(
            {'kind': kind, 'variables': variables, 'sensor': sensor, 'stamps_ns': []}
        )

    for index in range(clusters):
        stamp = START + index * 50_000_000
        sensor = ('left', 'right')[index % 2]
        members = [{'sensor': sensor, 'kind': 'lidar', 'stamp_ns': stamp}]
        kinds = ['pose']
        if index == 0:
            factor('prior_pose', ['x0'])
        if index >= 2:
            factor('odometry', [f'x{index - 2}', f'x{index}'], sensor)
        if index % 5 == 0:
            members.append({'sensor': 'gnss', 'kind': 'gnss', 'stamp_ns': stamp + 9_000_000})
            factor('gnss', [f'x{index}'], 'gnss')
        if index % 3 == 0:
            kinds += ['velocity', 'bias']
            if index > 0:
                ends = (index - 3, index)
                factor('imu', [f'{name}{end}' for end in ends for name in 'xvb'])
        graph['clusters'].append(
            {
                'id': index, 'stamp_ns': stamp, 'first_ns': stamp,
                'last_ns': members[-1]['stamp_ns'], 'window': index // 2, 'members': members,
            }
        )  # fmt: skip
        graph['variables'] += [
            {
                'key': f'{kind[0] if kind != "pose" else "x"}{index}', 'kind': kind,
                'cluster': index, 'stamp_ns': stamp, 'value': [],
            }
            for kind in kinds
        ]  # fmt: skip
    return graph


def check_picture(path: Path, least_variance: float = 1e-3) -> None:
    pixels = image.imread(path)
    height, width = pixels.shape[:2]
    assert 0.5 * WIDTH_PX < width <= WIDTH_PX and 600 <= height <= 0.75 * WIDTH_PX
    assert pixels[..., :3].var() > least_variance


@pytest.mark.parametrize('with_truth', [True, False])
def test_trajectory_is_drawn(tmp_path: Path, with_truth: bool) -> None:
    estimate = drive()
    # The truth covers a part of the drive only, in a map frame of its own.
    truth = Trajectory(
        estimate.stamps[5:40] + 1, estimate.positions[5:40] + 500.0, estimate.quaternions[5:40]
    )

    draw_trajectory(
        tmp_path / 'a.png', estimate, truth if with_truth else None, estimate.positions[::10]
    )

    check_picture(tmp_path / 'a.png')


@pytest.mark.parametrize('count', [0, 1])
def test_too_short_a_drive_makes_pictures(tmp_path: Path, count: int) -> None:
    full = drive()
    few = Trajectory(full.stamps[:count], full.positions[:count], full.quaternions[:count])

    draw_trajectory(tmp_path / 'a.png', few, full, NO_FIXES)
    draw_map(tmp_path / 'b.png', street(count), few)

    check_picture(tmp_path / 'a.png')
    check_picture(tmp_path / 'b.png')


def test_truth_of_another_time_is_left_out(tmp_path: Path) -> None:
    truth = Trajectory(drive().stamps + 10**15, drive().positions, drive().quaternions)

    draw_trajectory(tmp_path / 'a.png', drive(), truth, NO_FIXES)

    check_picture(tmp_path / 'a.png')


def test_map_is_drawn(tmp_path: Path) -> None:
    draw_map(tmp_path / 'a.png', street(), drive())

    check_picture(tmp_path / 'a.png', least_variance=1e-2)


def test_map_is_drawn_without_poses(tmp_path: Path) -> None:
    draw_map(tmp_path / 'a.png', street(), NO_POSES)

    check_picture(tmp_path / 'a.png', least_variance=1e-2)


def test_graph_is_drawn(tmp_path: Path) -> None:
    draw_graph(tmp_path / 'a.png', two_chains(), START, START + NANOSECONDS)

    check_picture(tmp_path / 'a.png', least_variance=1e-2)


def test_graph_of_no_cluster_is_drawn(tmp_path: Path) -> None:
    empty = {'format': 1, 'frame': 'map', 'variables': [], 'clusters': [], 'factors': []}

    draw_graph(tmp_path / 'a.png', empty, START, START + NANOSECONDS)

    check_picture(tmp_path / 'a.png')


def test_an_empty_span_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='is empty'):
        draw_graph(tmp_path / 'a.png', two_chains(), START, START)


def test_variables_without_a_path_are_unconnected() -> None:
    graph = two_chains()
    assert unconnected_variables(graph) == set()

    graph['factors'] = [item for item in graph['factors'] if 'x29' not in item['variables']]

    assert unconnected_variables(graph) == {'x29'}


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match='nowhere'):
        draw_map(tmp_path / 'nowhere' / 'a.png', street(), drive())


def test_side_of_a_long_drive_is_stretched(tmp_path: Path) -> None:
    points = street() * [20.0, 1.0, 1.0]
    path = Trajectory(drive().stamps, drive().positions * [20.0, 1.0, 1.0], drive().quaternions)

    figure = side_figure(points, path, WIDE)
    draw_map_side(tmp_path / 'a.png', points, path)

    axes = figure.axes[0]
    assert 'drawn' in axes.get_ylabel()
    assert axes.get_xlim()[0] < 0.0 and axes.get_xlim()[1] > 800.0
    assert axes.get_ylim()[0] < 0.0 and 6.0 < axes.get_ylim()[1] < 40.0
    pixels = image.imread(tmp_path / 'a.png')
    assert pixels.shape[:2] == (WIDE.height, WIDE.width)
    assert pixels[..., :3].var() > 1e-2


@pytest.mark.parametrize('turn', [0, 1], ids=['wide', 'tall'])
@pytest.mark.parametrize('page', [False, True])
def test_canvas_has_the_shape_of_the_drive(turn: int, page: bool) -> None:
    """A fixed shape left half of a picture white."""
    shape = np.array([[0.0, 0.0, 0.0], [120.0, 84.0, 0.0]])
    path = Trajectory(drive(2).stamps, shape[:, [turn, 1 - turn, 2]], drive(2).quaternions)
    figure = trajectory_figure(path, None, NO_FIXES, Look(width=1000, heading=not page))
    axes = figure.axes[0]
    width, height = axes_pixels(axes)
    shown = np.array([np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())])
    assert shown[0] / width == pytest.approx(shown[1] / height, rel=0.01)
    used = np.ptp(path.positions[:, :2], axis=0) / shown
    # Pages give all pictures one width, and bound the height.
    assert used.max() > 0.9 and used.min() > (0.45 if page and turn else 0.85)


def test_axes_are_east_and_north_where_the_map_is_georeferenced() -> None:
    for known, wanted in ((True, ('east, m', 'north, m')), (False, ('x, m', 'y, m'))):
        for figure in (
            map_figure(street(), drive(), Look(), known),
            trajectory_figure(drive(), None, NO_FIXES, Look(), known),
        ):
            axes = figure.axes[0]
            assert (axes.get_xlabel(), axes.get_ylabel()) == wanted


def test_side_says_what_it_is_projected_onto() -> None:
    north = Trajectory(drive().stamps, drive().positions[:, [2, 0, 2]], drive().quaternions)
    points = street()[:, [1, 0, 2]]
    for known, words in ((True, ' 0° from north'), (False, '90° from x')):
        label = side_figure(points, north, WIDE, known).axes[0].get_xlabel()
        assert label.startswith('projected onto a line at') and words in label


def test_a_standing_car_shows_its_fixes() -> None:
    still = Trajectory(drive().stamps, drive().positions * 1e-5, drive().quaternions)
    fixes = np.random.default_rng(1).normal(0.0, 0.02, (11, 3)) + [0.2, 0.1, 0.0]
    figure = trajectory_figure(still, None, fixes, Look())
    axes = figure.axes[0]
    assert np.ptp(axes.get_ylim()) < 1.0
    told = ' '.join(text.get_text() for text in figure.texts)
    assert 'at rest: 50 poses within 0.000 m, 11 fixes within 0.' in told


def colours_of(figure: Any) -> Any:
    """Which height has which colour, as the bar beside the map says."""
    return figure.axes[1]._colorbar.norm


def test_few_tall_buildings_leave_colours_for_the_street() -> None:
    """A kerb on a street with a tower: by height alone both had the colour of the road."""
    road, kerb = street(9000) * [1, 1, 0.0], street(900) * [1, 1, 0.0] + [0, 0, 0.15]
    tower = street(400) * [0.1, 0.1, 10.0]
    points = np.concatenate([road, kerb, tower]).astype(np.float32)
    points[:, 2] += np.random.default_rng(2).normal(0.0, 0.02, len(points)).astype(np.float32)
    figure = map_figure(points, drive(), Look())
    norm = colours_of(figure)
    assert norm(0.15) - norm(0.0) > 0.1
    assert norm(55.0) - norm(30.0) > 0.1
    assert norm(norm.inverse(0.37)) == pytest.approx(0.37, abs=1e-6)


def test_a_street_that_climbs_keeps_its_colour() -> None:
    slope = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]]).T
    hill = Trajectory(drive().stamps, drive().positions @ slope.T, drive().quaternions)
    flat = street() * [1, 1, 0.0]
    norm = colours_of(map_figure(flat @ slope.T, hill, Look()))
    assert norm.vmax - norm.vmin < 2.0  # the street climbs by 20 m


def test_side_of_a_short_drive_keeps_its_scale() -> None:
    axes = side_figure(street() * [0.1, 0.1, 1.0], drive(1), WIDE).axes[0]
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    width, height = axes_pixels(axes)
    assert axes.get_ylabel() == 'z, m'
    assert (right - left) / width == pytest.approx((top - bottom) / height)


@pytest.mark.parametrize('suffix', ['.svg', '.pdf'])
def test_same_picture_is_the_same_file(tmp_path: Path, suffix: str) -> None:
    for name in 'ab':
        draw_graph(tmp_path / (name + suffix), two_chains(), START, START + NANOSECONDS)

    content = (tmp_path / f'a{suffix}').read_bytes()
    assert len(content) > 20_000
    assert content == (tmp_path / f'b{suffix}').read_bytes()


def test_other_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"'.gif'; pictures are .png, .svg, .pdf"):
        draw_graph(tmp_path / 'a.gif', two_chains(), START, START + NANOSECONDS)


def test_dark_pictures_are_dark(tmp_path: Path) -> None:
    for theme in (LIGHT, DARK):
        draw_graph(tmp_path / 'a.png', two_chains(), START, START + NANOSECONDS, Look(theme=theme))
        pixels = image.imread(tmp_path / 'a.png')[..., :3]
        assert (pixels.mean() > 0.7) == (theme is LIGHT)
        assert pixels.var() > 5e-3


def test_picture_of_a_page_has_no_colour_of_its_own() -> None:
    figure, shown = graph_figure(two_chains(), START, START + NANOSECONDS, Look(theme=PAGE))
    text = svg_for_page(figure, 'here', 'Graph "of" <two> chains')

    assert shown.clusters == 21 and shown.unconnected == 0
    assert text.startswith('<svg') and text.endswith('</svg>')
    assert 'aria-label="Graph &quot;of&quot; &lt;two> chains"' in text
    assert '#01' not in text
    assert {'var(--ink)', 'var(--node)', 'var(--blue)', 'var(--even)'} <= set(
        re.findall(r'var\(--[a-z-]+\)', text)
    )
    assert all(name.startswith('here-') for name in re.findall(r'id="([^"]*)"', text))


def test_seconds_count_from_a_given_stamp() -> None:
    look = Look(heading=False)
    figure, _ = graph_figure(two_chains(), START, START + NANOSECONDS, look, START - NANOSECONDS)
    assert figure.axes[0].get_xlim() == pytest.approx((1.0, 2.0))


def test_colours_of_the_themes_stand_for_one_thing_each() -> None:
    for theme in (LIGHT, DARK, PAGE):
        colours = [getattr(theme, field.name) for field in fields(theme)]
        assert len(set(colours)) == len(colours)


def test_missing_matplotlib_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)

    with pytest.raises(OutputError, match=r'incremental_mapper\[report\]'):
        draw_map(tmp_path / 'a.png', street(), drive())


def keyframes(*seconds: float) -> dict[str, Any]:
    """A graph of poses alone, of a LiDAR without anything beside it."""
    stamps = [START + round(second * NANOSECONDS) for second in seconds]
    return {
        'clusters': [
            {
                **{name: stamp for name in ('stamp_ns', 'first_ns', 'last_ns')},
                'id': number,
                'window': number,
                'members': [{'sensor': 'top', 'kind': 'lidar', 'stamp_ns': stamp}],
            }
            for number, stamp in enumerate(stamps)
        ],
        'variables': [
            {'key': f'x{number}', 'kind': 'pose', 'cluster': number}
            for number in range(len(stamps))
        ],
        'factors': [],
    }


def test_a_stretch_that_nobody_chose_has_some_clusters_in_it() -> None:
    sparse = keyframes(0.0, 6.0, 8.0, 8.4, 8.8, 9.2, 9.6, 10.0, 12.0)
    start, end = ((stamp - START) / NANOSECONDS for stamp in typical_stretch(sparse, 1.5))
    assert (start, end) == pytest.approx((7.8, 10.2))
    few = keyframes(1.0, 1.2, 1.4)
    start, end = ((stamp - START) / NANOSECONDS for stamp in typical_stretch(few, 1.5))
    assert (start, end) == pytest.approx((1.0, 2.5))
    dense = keyframes(*np.arange(100) / 10.0)
    start, end = ((stamp - START) / NANOSECONDS for stamp in typical_stretch(dense, 1.5))
    assert (start, end) == pytest.approx((4.2, 5.7))


def test_a_graph_without_velocities_has_no_row_for_them() -> None:
    graph = keyframes(0.0, 0.4)
    figure, _ = graph_figure(graph, START, START + NANOSECONDS, Look())
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ['X  pose', 'top']
    assert '2 clusters, 2 variables, 0 factors' in ' '.join(
        text.get_text() for text in figure.texts
    )
    one = keyframes(0.0)
    figure, _ = graph_figure(one, START, START + NANOSECONDS, Look())
    assert '1 cluster, 1 variable, 0 factors' in ' '.join(text.get_text() for text in figure.texts)
