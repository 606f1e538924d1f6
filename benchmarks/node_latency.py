"""Messages lost and end-to-end latency of the node, and what it does when it is overloaded.

    python benchmarks/node_latency.py WORK_DIR [--seconds 60] [--config config/kaist.yaml]
                                      [--rate 1] [--overload 5 10 20]

Simulates a drive at KAIST's rates (two clouds of about 14 600 points at 10 Hz, IMU at 100 Hz, a
fix a second) into WORK_DIR once, then plays it into a node; node, player and this listener are
three programs. Prints Markdown.

Latency is taken between two times of the middleware on one clock: from when the player published
a message to when the window's ~/odometry was received here. It is given twice:

from the closing message
    the message that let the window be closed. A window is closed once every sensor that is alive
    has passed its end or is not due before it, or has been waited for as long as is usual for it
    (``window.predict``), or once one is ``window.lateness`` (0.5 s) beyond it. Which message it was
    is found by handing all of them, in the order in which they were published, to the same window
    buffer that the node uses. This is what mapping and transport take.
from the window's own last message
    the newest message whose stamp lies in the window. This is how old a pose is when it comes,
    waiting for what may still belong to the window included.

Windows that only the end of the bag closed have no closing message and are left out. At the rates
of ``--overload`` the same bag is played until one of them is too much for the node.
"""

import argparse
import json
import struct
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from node_runs import PATIENCE, Drive, NodeRun, lost_table, make_drive, node_run
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from incremental_mapper.datasets.bag_files import open_bag
from incremental_mapper.errors import InputError, MapperError
from incremental_mapper.mapping.window_buffer import WindowBuffer
from incremental_mapper.measurements import (
    NANOSECONDS,
    FixStatus,
    GnssFix,
    ImuSample,
    LidarScan,
    Measurement,
)
from incremental_mapper.ros.client import Heard
from incremental_mapper.settings import make_config, merge, read_yaml

KINDS = {'imu': Imu, 'gnss': NavSatFix}
ONE_POINT = np.ones((1, 3), dtype=np.float32)
LISTENING = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, slots=True)
class Published:
    """A sensor's message: its header stamp, and when the player published it; ns."""

    sent: int
    stamp: int
    sensor: str


@dataclass(frozen=True, slots=True)
class Closing:
    """When a window's last own message and the one that closed it were published; ns."""

    own: int
    closing: int


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('work', type=Path, metavar='WORK_DIR')
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    parser.add_argument('--rate', type=float, default=1.0)
    parser.add_argument('--overload', type=float, nargs='*', default=[5.0, 10.0, 20.0])
    args = parser.parse_args()
    try:
        args.work.mkdir(parents=True, exist_ok=True)
        drive = make_drive(args.work, args.seconds, args.config)
        latency(drive, args.rate, args.work / 'node.log')
        for rate in args.overload:
            if overload(drive, rate, args.work / f'node_rate_{rate:g}.log'):
                break
    except MapperError as error:
        print(f'{Path(__file__).name}: {error}', file=sys.stderr)
        return 1
    return 0


def latency(drive: Drive, rate: float, log: Path) -> None:
    """Play at a rate that the node should keep up with, and print what was measured."""
    published: list[Published] = []
    with node_run(drive, log, {}) as run:
        record(run, published)
        fullest = 0

        def look() -> None:
            nonlocal fullest
            fullest = max(fullest, run.client.diagnostics[-1]['worker']['queue_core'])

        run.play(rate, look)
        run.catch_up()
        seen = len(run.client.odometry)
        run.client.call('flush', PATIENCE)
        worker = run.parts()['worker']
        print(f'\n## {drive.seconds:.1f} s at {rate:g} times real time\n')
        print(f'Player: {run.player_said}\n')
        print(lost_table(run))
        print(
            f'\nQueue: at most {fullest} scans and fixes waited; {worker["limited_windows"]} '
            f'windows with less search, {worker["merged_windows"]} merged.'
        )
        if worker['limited_windows']:
            print('The node fell behind: the latencies below are mostly time in the queue.')
        missed = missing(run, published, rate)
        if missed:
            print(f'This listener missed {len(missed)} messages; their windows are left out.')
        closings = find_closings(published, missed, drive)
        print_latency(run, run.client.odometry[:seen], closings)


def record(run: NodeRun, published: list[Published]) -> None:
    """Listen to the inputs of the node too; only their stamps are looked at."""

    def take(sensor: str, heard: Heard) -> None:
        published.append(Published(heard.sent, header_stamp(heard.message), sensor))

    for sensor, topic in run.topics.items():
        kind = KINDS.get(sensor, PointCloud2)
        run.client.listen(topic, kind, partial(take, sensor), LISTENING, raw=True)


def missing(run: NodeRun, published: Sequence[Published], rate: float) -> list[Published]:
    """Messages of the bag that did not come here, at the times when they must have been sent."""
    sensors = {topic: sensor for sensor, topic in run.topics.items()}
    heard = {(item.stamp, item.sensor): item.sent for item in published}
    logged: dict[tuple[int, str], int] = {}
    reader = open_bag(run.drive.bag)
    connections = [item for item in reader.connections if item.topic in sensors]
    for connection, log_stamp, data in reader.messages(connections):
        logged[header_stamp(data), sensors[connection.topic]] = log_stamp
    reader.close()
    if not heard:
        raise InputError('this listener heard nothing of what was played')
    first = min(heard, key=lambda key: heard[key])
    return [
        Published(round(heard[first] + (log_stamp - logged[first]) / rate), stamp, sensor)
        for (stamp, sensor), log_stamp in logged.items()
        if (stamp, sensor) not in heard
    ]


def header_stamp(message: bytes) -> int:
    """The stamp (ns) of a serialised message: four bytes of encoding come before its header."""
    seconds, nanoseconds = struct.unpack_from('<iI', message, 4)
    return seconds * NANOSECONDS + nanoseconds


def find_closings(
    published: Sequence[Published], missed: Sequence[Published], drive: Drive
) -> dict[tuple[int, int], Closing]:
    """Closings by start and end (ns) of the windows that were heard completely."""
    tree: dict[str, object] = {}
    for path in drive.settings:
        tree = merge(tree, read_yaml(path))
    window = make_config(tree).window
    buffer = WindowBuffer(window, drive.counts, window.predict)
    sent = {(item.stamp, item.sensor): item.sent for item in published}
    closings: dict[tuple[int, int], Closing] = {}
    for item in sorted([*published, *missed], key=lambda item: item.sent):
        buffer.push(as_measurement(item))
        for window in buffer.pop_ready():
            own = [sent.get((m.stamp, m.sensor)) for m in (*window.core, *window.imu)]
            if None not in own and (item.stamp, item.sensor) in sent:
                closings[window.start, window.end] = Closing(max(own), item.sent)
    return closings


def as_measurement(item: Published) -> Measurement:
    """A measurement with the stamp of a message and nothing else."""
    if item.sensor == 'imu':
        return ImuSample(item.stamp, item.sensor, np.zeros(3), np.zeros(3))
    if item.sensor == 'gnss':
        return GnssFix(item.stamp, item.sensor, 0.0, 0.0, 0.0, FixStatus.FIX)
    return LidarScan(item.stamp, item.sensor, ONE_POINT)


def print_latency(
    run: NodeRun, odometry: Sequence[Heard], closings: Mapping[tuple[int, int], Closing]
) -> None:
    """Both latencies, and what the mapper alone takes."""
    bounds = {
        stats['stamp_ns']: (stats['window.start_ns'], stats['window.end_ns'])
        for stats in run.client.stats
        if stats['window.core']
    }
    pairs: list[tuple[Heard, Closing]] = []
    for heard in odometry:
        stamp = heard.message.header.stamp
        window = bounds.get(stamp.sec * NANOSECONDS + stamp.nanosec)
        if window in closings:
            pairs.append((heard, closings[window]))
    if not pairs:
        raise InputError('no window could be matched with the messages that closed it')
    print(f'\nLatency of {len(pairs)} of {len(odometry)} windows:\n')
    print('| ms | p50 | p95 | p99 | worst |\n|---|---|---|---|---|')
    measures: list[tuple[str, Callable[[Heard, Closing], int]]] = [
        ('from the closing message', lambda heard, closing: heard.received - closing.closing),
        ("from the window's last message", lambda heard, closing: heard.received - closing.own),
    ]
    for name, measure in measures:
        print_quantiles(name, [measure(*pair) / 1e6 for pair in pairs])
    windows = [stats['window.window_s'] for stats in run.client.stats if stats['window.core']]
    print_quantiles('mapping the window alone', [1e3 * seconds for seconds in windows])


def print_quantiles(name: str, values: Sequence[float]) -> None:
    """A row of the table."""
    cells = [f'{value:.0f}' for value in np.percentile(values, [50, 95, 99, 100])]
    print(f'| {name} | ' + ' | '.join(cells) + ' |')


def overload(drive: Drive, rate: float, log: Path) -> bool:
    """Play fast and print what the node did; returns whether it was too much for the node."""
    with TemporaryDirectory() as scratch:
        parameters = {'save.folder': f'{scratch}/saved'}
        with node_run(drive, log, parameters) as run:
            fullest, candidates, windows = 0, np.inf, 1

            def look() -> None:
                nonlocal fullest, candidates, windows
                worker = run.client.diagnostics[-1]['worker']
                fullest = max(fullest, worker['queue_core'])
                if worker['candidates_limit'] is not None:
                    candidates = min(candidates, worker['candidates_limit'])
                windows = max(windows, worker['windows_merged_into_one'])

            run.play(rate, look)
            run.catch_up()
            run.client.call('flush', PATIENCE)
            success, message = run.client.call('save_map', PATIENCE)
            if not success:
                raise InputError(message)
            parts = run.parts()
            worker = parts['worker']
            print(f'\n## Overload: {rate:g} times real time\n')
            print(f'Player: {run.player_said}\n')
            print(lost_table(run))
            behind = bool(worker['limited_windows'] or worker['merged_windows'])
            if behind:
                print(
                    f'\nThe node fell behind: at most {fullest} scans and fixes waited. '
                    f'{worker["limited_windows"]} of {parts["map"]["windows"]} windows were '
                    f'searched less, at worst {candidates:g} candidates; '
                    f'{worker["merged_windows"]} windows were merged into others, at most '
                    f'{windows} into one. Components of the graph: {parts["map"]["components"]}.'
                )
            else:
                print(f'\nThe node kept up: at most {fullest} scans and fixes waited.')
            print_balance(run, parts, Path(scratch) / 'saved')
    return behind


def print_balance(run: NodeRun, parts: Mapping[str, dict], folder: Path) -> None:
    """Whether every core measurement that was played is in the graph or counted somewhere."""
    graph = json.loads((folder / 'graph.json').read_text())
    used = Counter(core['sensor'] for item in graph['clusters'] for core in item['members'])
    core = [sensor for sensor in run.drive.counts if sensor != 'imu']
    unseen = {
        sensor: run.drive.counts[sensor]
        - used[sensor]
        - sum(parts[sensor]['dropped'].values())
        - parts[sensor]['lost_in_transport']
        for sensor in core
    }
    print(
        'Scans and fixes: '
        + ', '.join(f'{used[sensor]} of {run.drive.counts[sensor]} of {sensor}' for sensor in core)
        + ' are in the graph; '
        + ('every other one is counted above.' if not any(unseen.values()) else f'LOST: {unseen}')
    )


if __name__ == '__main__':
    sys.exit(main())
