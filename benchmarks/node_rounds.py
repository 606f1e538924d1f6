"""Hours of driving through DDS and a node: memory, latency, drops.

    python benchmarks/node_rounds.py WORK_DIR [--seconds 60] [--rounds 60] [--rate 5]
                                     [--config config/kaist.yaml] [--samples CSV]

Simulates a drive of ``--seconds`` into WORK_DIR once, and publishes it ``--rounds`` times, each
round going on where the one before it ended: stamps and fixes are moved, so that an hour needs no
bag of an hour. It goes as fast as the node follows, at most ``--rate`` times real time: the
publisher waits while more than a few scans wait in the node. Prints Markdown; exit status 1 where a
message was lost, or memory beyond the map grows.

Latency is from when a message was published to when the ~/odometry of its stamp was received; of a
drive that is faster than real time it says how deep the queue was, no more.
"""

import argparse
import sys
import time
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from graph_memory import graph_bytes, piece_sizes, resident
from long_drive import MovedPlaces, RepeatedDrive
from node_runs import PATIENCE, Drive, NodeRun, lost_table, make_drive, node_run, publishers
from node_soak import MB, SAMPLE, Sample, print_fits, write_samples
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import NavSatFix

from incremental_mapper.datasets.bag_files import open_bag
from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import MapperError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.settings import read_yaml

WAITING = 15
"""Scans and fixes that may wait in the node before the publisher waits."""
MOST_GROWTH = 5.0
"""MB a minute of driving beyond the map."""


@dataclass(frozen=True, slots=True)
class Raw:
    """A message of the bag: seconds since its first, sensor, header stamp (ns), bytes."""

    at: float
    sensor: str
    stamp: int
    data: bytes


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('work', type=Path, metavar='WORK_DIR')
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--rounds', type=int, default=60)
    parser.add_argument('--rate', type=float, default=5.0)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    parser.add_argument('--samples', type=Path, metavar='CSV', help='keep the samples')
    args = parser.parse_args()
    try:
        args.work.mkdir(parents=True, exist_ok=True)
        drive = make_drive(args.work, args.seconds, args.config)
        samples, whole = run_rounds(drive, args.rounds, args.rate, args.config, args.work / 'log')
        if args.samples is not None:
            write_samples(args.samples, samples)
        growth = print_fits(samples)
    except MapperError as error:
        print(f'{Path(__file__).name}: {error}', file=sys.stderr)
        return 1
    return 0 if whole and growth < MOST_GROWTH else 1


def run_rounds(
    drive: Drive, rounds: int, rate: float, config: Path, log: Path
) -> tuple[list[Sample], bool]:
    """Publish and watch; returns the samples, and whether every message came and was used."""
    repeated = RepeatedDrive(open_source(drive.bag, read_yaml(config)), rounds)
    raw = read_raw(drive)
    sizes, samples, times = piece_sizes(), list[Sample](), dict[int, int]()
    begin = time.monotonic()
    # The publisher waits for the node: nothing need be left out for a delay.
    with node_run(drive, log, {'queue.max_delay': 0.0}) as run:
        send = publishers(run)
        begun = time.monotonic()
        places, span = MovedPlaces(repeated.step), repeated.span / NANOSECONDS
        for number in range(rounds):
            shift = number * repeated.span
            for item in raw:
                due = begun + (item.at + number * span) / rate
                # Whoever was held up does not make up for it.
                begun += max(time.monotonic() - due, 0.0)
                time.sleep(max(due - time.monotonic(), 0.0))
                data = shifted(item, shift, places)
                times[item.stamp + shift] = time.time_ns()
                send[item.sensor](data)
                follow(run, samples, sizes, begin)
            places.next_round()
        run.catch_up()
        heard = len(run.client.odometry)
        run.client.call('flush', PATIENCE)
        parts = run.parts()
        wall = time.monotonic() - begin
        seconds = rounds * span
        print(f'\n## {seconds / 60:.1f} min of driving in {wall / 60:.1f} min\n')
        counts = {name: count * rounds for name, count in drive.counts.items()}
        print(lost_table(NodeRun(Drive(drive.bag, (), counts, seconds), run.client, 0, {})))
        worker = parts['worker']
        print(
            f'\n{worker["limited_windows"]} windows searched less, {worker["merged_windows"]} '
            f'merged, {worker["late_but_used"]} late but used; {parts["map"]["components"]} '
            f'component, {parts["map"]["clusters"]} clusters, {worker["mapper_failures"]} failures'
        )
        print_latencies(run, heard, times)
        whole = all(
            parts[name]['received'] == count and not any(parts[name]['dropped'].values())
            for name, count in counts.items()
        )
    return samples, whole and parts['map']['components'] == 1


def read_raw(drive: Drive) -> list[Raw]:
    """The sensors' messages of the bag in the order of recording."""
    sensors = {'/points_left': 'left', '/points_right': 'right', '/imu': 'imu', '/fix': 'gnss'}
    reader = open_bag(drive.bag)
    first, found = None, []
    wanted = [item for item in reader.connections if item.topic in sensors]
    for connection, logged, data in reader.messages(wanted):
        first = logged if first is None else first
        seconds, nanoseconds = np.frombuffer(data[4:12], dtype='<i4')
        stamp = int(seconds) * NANOSECONDS + int(nanoseconds)
        at = (logged - first) / NANOSECONDS
        found.append(Raw(at, sensors[connection.topic], stamp, bytes(data)))
    reader.close()
    return found


def shifted(item: Raw, shift: int, places: MovedPlaces) -> bytes:
    """A message with another stamp, a fix also at another place."""
    header = np.array(divmod(item.stamp + shift, NANOSECONDS), dtype='<i4').tobytes()
    data = item.data[:4] + header + item.data[12:]
    if item.sensor != 'gnss':
        return data
    fix = deserialize_message(data, NavSatFix)
    there = places.moved(fix.latitude, fix.longitude, fix.altitude)
    fix.latitude, fix.longitude, fix.altitude = there
    return bytes(serialize_message(fix))


def follow(run: NodeRun, samples: list[Sample], sizes: Mapping[str, float], begin: float) -> None:
    """Wait while the node is behind, and take a sample now and then."""
    while run.client.diagnostics[-1]['worker']['queue_core'] > WAITING:
        run.client.fresh_diagnostics(PATIENCE)
    now = time.monotonic() - begin
    if not run.client.stats or (samples and now - samples[-1].wall_s < SAMPLE):
        return
    worker, stats = run.client.diagnostics[-1]['worker'], run.client.stats[-1]
    samples.append(
        Sample(
            wall_s=now,
            drive_s=stats['drive_s'],
            rss_mb=resident(run.pid) / MB,
            scans_mb=worker['scans_mb'],
            voxels_mb=worker['voxels_mb'],
            graph_mb=graph_bytes(sizes, stats) / MB,
            queue_mb=worker['queue_mb'],
            queue_core=worker['queue_core'],
        )
    )


def print_latencies(run: NodeRun, heard: int, times: Mapping[int, int]) -> None:
    """Latency by tenths of the drive: what grows shows."""
    stamps = sorted(times)
    found = []
    for item in run.client.odometry[:heard]:
        header = item.message.header.stamp
        stamp = header.sec * NANOSECONDS + header.nanosec
        place = bisect_left(stamps, stamp)
        if place < len(stamps) and stamps[place] == stamp:
            found.append((item.received - times[stamp]) / 1e6)
    print('\n| ms from message to odometry | p50 | p99 | worst |\n|---|---|---|---|')
    for name, values in (
        ('first tenth', found[: len(found) // 10]),
        ('last tenth', found[-(len(found) // 10) :]),
        ('all', found),
    ):
        cells = [f'{value:.0f}' for value in np.percentile(values, [50, 99, 100])]
        print(f'| {name}, {len(values)} windows | ' + ' | '.join(cells) + ' |')
    print()


if __name__ == '__main__':
    sys.exit(main())
