"""The paper's figure 2 as a real run: a fix with no IMU sample around it.

Two LiDARs, GNSS and an IMU; around one fix a few IMU samples are missing. The base graph gives the
fix a variable that nothing else touches. The method puts the fix into a cluster with a scan, so
that its information reaches the rest.

    python examples/figure2.py docs/figure2.png
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d

from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan, Measurement
from incremental_mapper.results.graph_json import graph_tree
from incremental_mapper.settings import make_config
from incremental_mapper.visualization.figure import Look, new_figure, save
from incremental_mapper.visualization.graph_legend import add_graph_legend
from incremental_mapper.visualization.graph_picture import Shown, paint_graph

MS = 1_000_000
START = 1_544_581_126_000 * MS
SECONDS = 1.5
SPEED = 4.0
"""m/s along x, through a made-up street."""
FIX = START + 770 * MS
"""Stamp of the fix: 40 ms after a scan of the right LiDAR, 30 ms before one of the left."""
HOLE = 55 * MS
"""IMU samples nearer to the fix than this are missing: no span may reach so far without one."""
SENSORS = ('left', 'right')
SETTINGS: dict[str, Any] = {
    'lidars': {'names': list(SENSORS)},
    'odometry': {'method': 'gicp', 'min_range': 1.0},
    'preintegration': {'max_gap': 0.05},
    'mom': {'max_points': 300},
}


def street(count: int = 9000, seed: int = 2) -> np.ndarray:
    """Points (N, 3) in metres on the ground, on house fronts and on their corners."""
    rng = np.random.default_rng(seed)
    low, high = [-30.0, -9.0, 0.0], [45.0, 9.0, 7.0]
    points = rng.uniform(low, high, size=(count, 3))
    third = count // 3
    points[:third, 2] = 0.0
    points[third : 2 * third, 1] = np.sign(points[third : 2 * third, 1]) * 9.0
    points[2 * third :, 0] = np.round(points[2 * third :, 0] / 8.0) * 8.0
    inner = np.abs(points[2 * third :, 1])
    points[2 * third :, 1] = np.sign(points[2 * third :, 1]) * (6.5 + inner / 9.0 * 2.5)
    return points


def imu_stamps() -> list[int]:
    """100 Hz, but for the samples around the fix."""
    stamps = range(START - 100 * MS, START + round(SECONDS * 1000) * MS, 10 * MS)
    return [stamp for stamp in stamps if abs(stamp - FIX) >= HOLE]


def measurements() -> list[Measurement]:
    """What the sensors of a car in steady motion see, in the order of their stamps."""
    points, made = street(), []
    for number in range(int(SECONDS * 10)):
        for offset, sensor in zip((0, 30), SENSORS, strict=True):
            stamp = START + (number * 100 + offset) * MS
            x = SPEED * (stamp - START) / 1e9
            made.append(LidarScan(stamp, sensor, (points - [x, 0, 1.5]).astype(np.float32)))
    x = SPEED * (FIX - START) / 1e9
    place = map(float, pymap3d.enu2geodetic(x, 0.0, 0.0, 36.5, 127.25, 50.0))
    made.append(GnssFix(FIX, 'gnss', *place, FixStatus.GBAS, np.eye(3) * 0.05**2))
    made += [
        ImuSample(stamp, 'imu', np.zeros(3), np.array([0.0, 0.0, 9.81])) for stamp in imu_stamps()
    ]
    return sorted(made, key=lambda item: (item.stamp, item.sensor))


def run(strategy: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Map the stream; the keys of stats.json, and the layout of graph.json."""
    config = make_config(SETTINGS | {'selection': {'strategy': strategy}}, 'figure 2')
    mapper = Mapper(config, [*SENSORS, 'gnss', 'imu'])
    for measurement in measurements():
        mapper.push(measurement)
    result = mapper.finish()
    return result.stats, graph_tree(result.clusters, result.factors, result.values)


def companions(graph: dict[str, Any]) -> list[str]:
    """The sensors whose scans are in the cluster of the fix."""
    clusters = [[m['sensor'] for m in item['members']] for item in graph['clusters']]
    return [name for names in clusters if 'gnss' in names for name in names if name != 'gnss']


def panels() -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Both strategies: name, statistics, graph."""
    for strategy in ('base', 'mom'):
        yield strategy, *run(strategy)


def draw(path: Path) -> dict[str, tuple[int, Shown]]:
    """Draw both graphs around the fix; components, and what is shown, by strategy."""
    look = Look(width=1600, height=760)
    figure, told, graphs = new_figure(look), {}, []
    for column, (strategy, stats, graph) in enumerate(panels()):
        left = 0.085 + 0.475 * column
        axes = figure.add_axes((left, 0.155, 0.425, 0.7))
        span = (FIX - 185 * MS, FIX + 175 * MS)
        shown = paint_graph(axes, graph, *span, look, START, imu_stamps())
        if column:
            axes.set_yticks([])
        parts = stats['components']
        others = companions(graph)
        says = (
            f'{parts} components: the fix moves nothing but its own variable'
            if parts > 1
            else f'1 component: the fix shares a pose with the scan of {" and ".join(others)}'
        )
        colour = look.theme.unconnected_edge if parts > 1 else look.theme.green
        figure.text(left, 0.93, strategy, fontsize=19, fontweight='bold', color=look.theme.ink)
        figure.text(left, 0.883, says, fontsize=14, color=colour)
        told[strategy] = (parts, shown)
        graphs.append(graph)
    add_graph_legend(figure, graphs, look)
    save(figure, path)
    return told


if __name__ == '__main__':
    target = Path(sys.argv[1] if len(sys.argv) > 1 else 'figure2.png')
    for name, (parts, shown) in draw(target).items():
        unconnected = f'{shown.unconnected} of the variables shown not connected'
        print(f'{name}: {parts} components, {unconnected}')
    print(target)
