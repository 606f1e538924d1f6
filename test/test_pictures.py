import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from incremental_mapper.errors import OutputError
from incremental_mapper.evaluation.graph_picture import draw_graph, loose_variables
from incremental_mapper.evaluation.pictures import HEIGHT_PX, WIDTH_PX, draw_map, draw_trajectory
from incremental_mapper.trajectory import NANOSECONDS, Trajectory

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
    assert pixels.shape[:2] == (HEIGHT_PX, WIDTH_PX)
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


def test_variables_without_a_path_are_loose() -> None:
    graph = two_chains()
    assert loose_variables(graph) == set()

    graph['factors'] = [item for item in graph['factors'] if 'x29' not in item['variables']]

    assert loose_variables(graph) == {'x29'}


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match='nowhere'):
        draw_map(tmp_path / 'nowhere' / 'a.png', street(), drive())


def test_missing_matplotlib_is_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'matplotlib.figure', None)

    with pytest.raises(OutputError, match=r'incremental_mapper\[report\]'):
        draw_map(tmp_path / 'a.png', street(), drive())
