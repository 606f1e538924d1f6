"""The published map: it costs the odometry nothing, however large it has become."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from node_latency import Published, record
from node_runs import PATIENCE, Drive, make_drive, node_run

from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.ros.programs import running
from robot_rows import Seen, row

CONFIG = Path(__file__).resolve().parents[2] / 'config' / 'kaist.yaml'
SECONDS = 60.0
FINE = 0.02
"""Voxels of a map that becomes as large within a minute as others do within an hour, metres."""
LIMIT = 0.15
"""Seconds that the 99th percentile of the latency may be with a reader above that without."""
READER = """
import sys, rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from incremental_mapper.ros.publishers import reliable
rclpy.init()
node = Node('reader')
def take(message):
    print(message.width, message.row_step, flush=True)
node.create_subscription(
    PointCloud2, '/incremental_mapper/map', take, reliable(1, latched=True)
)
try:
    rclpy.spin(node)
except BaseException:
    pass
"""


@row('with one reader p99 15 s and 43 windows merged: 113 MB every 2 s')
def reader_of_a_large_map(folder: Path) -> Seen:
    """Latency of ~/odometry without and with a reader of ~/map, whose map grows to millions."""
    drive = make_drive(folder, SECONDS, CONFIG)
    alone, _, merged_alone, _ = _latency(drive, folder, reads=False, bounded=True)
    beside, sizes, merged, voxels = _latency(drive, folder, reads=True, bounded=True)
    most = max(sizes, default=0)
    slower = float(np.percentile(beside, 99) - np.percentile(alone, 99))
    text = (
        f'{_spread(alone)} without, {_spread(beside)} with a reader, {merged_alone} and {merged} '
        f'windows merged; {len(sizes)} maps of at most {most} points, of {voxels:.0f} MB of voxels'
    )
    ok = slower <= LIMIT and merged <= merged_alone and len(sizes) > 10 and 0 < most <= 1_000_000
    return Seen(text, ok)


@row('the same with an unbounded map', long=True)
def reader_of_an_unbounded_map(folder: Path) -> Seen:
    """The same with display_points and display_radius 0: fewer maps, and each of them whole."""
    drive = make_drive(folder, SECONDS, CONFIG)
    beside, sizes, merged, voxels = _latency(drive, folder, reads=True, bounded=False)
    text = (
        f'{_spread(beside)}, {merged} windows merged; {len(sizes)} maps of at most '
        f'{max(sizes, default=0)} points, of {voxels:.0f} MB of voxels'
    )
    return Seen(text, len(sizes) > 3 and float(np.percentile(beside, 50)) < 0.5)


def _spread(seconds: Sequence[float]) -> str:
    p50, p99 = np.percentile(seconds, [50, 99])
    return f'p50 {1e3 * p50:.0f} ms, p99 {1e3 * p99:.0f} ms'


def _latency(
    drive: Drive, folder: Path, reads: bool, bounded: bool
) -> tuple[list[float], list[int], int, float]:
    """Play the drive.

    Returns:
        Seconds from the publication of a measurement to the odometry of its stamp, in the second
        half of the drive; the points of each map; windows that were merged; MB of voxels.
    """
    parameters: dict[str, object] = {'map.voxel_size': FINE}
    if not bounded:
        parameters |= {'map.display_points': 0, 'map.display_radius': 0.0}
    published: list[Published] = []
    said = folder / f'reader_{reads}_{bounded}.txt'
    with node_run(drive, folder / f'node_{reads}_{bounded}.log', parameters) as run:
        record(run, published)
        with said.open('w') as file:
            if reads:
                command = [sys.executable, '-c', READER]
                with running(command, run.environment, file, subprocess.DEVNULL):
                    run.play(1.0)
                    run.catch_up()
            else:
                run.play(1.0)
                run.catch_up()
        run.client.call('flush', PATIENCE)
        worker = run.parts()['worker']
        sent = {item.stamp: item.sent for item in published}
        heard = [
            (item, item.message.header.stamp.sec * NANOSECONDS + item.message.header.stamp.nanosec)
            for item in run.client.odometry
        ]
    passed = [(item.received - sent[stamp]) / NANOSECONDS for item, stamp in heard if stamp in sent]
    if len(passed) < SECONDS:
        raise InputError(f'{len(passed)} poses came of {SECONDS:g} s')
    sizes = [int(line.split()[0]) for line in said.read_text().splitlines()]
    return passed[len(passed) // 2 :], sizes, worker['merged_windows'], worker['voxels_mb']
