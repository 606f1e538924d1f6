"""Hostile messages among those of a drive: no crash, flat memory, and the map that it gives alone.

    python benchmarks/fuzz.py [--count 20000] [--seeds 1,2,3,4,5] [--seconds 5] [--only map|node]
                              [--rate 0.1] [--kinds REGEX] [--domain N] [--out FOLDER]

A short simulated drive is mapped alone and with hostile messages among its own: clouds whose
layout is nonsense, values that are no numbers, stamps of other centuries, data that are cut or
noise (``lies.hostile`` has them, drawn with a seed). ``map`` reads them from a bag, and the node
gets them over DDS from a publisher, as raw data where they are raw, no faster than it follows:
what is asked is what the messages do, and not what overload does. Printed are exit status, memory
over time, and how far the two trajectories are apart; the exit status is 1 where a program crashed,
memory grew, or the maps differ by more than their noise. ``--kinds`` sends those hostile messages
alone whose topic and kind (``/imu stray``) it matches: where a seed fails, they tell which.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from lies.hostile import KINDS, Sent, mixed, valid
from lies.recording import DRIVES, STORE, TRUTH, Recording, make_drive
from rosbags.rosbag2 import StoragePlugin, Writer

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.errors import InputError
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.trajectory import match_truth, read_tum

NOISE = 0.025
"""Metres. RMS between the trajectories of one drive without its first 0 to 3 scans, so that windows
begin elsewhere: 0.010 to 0.022 in the six pairs of four runs."""
GROWTH = 60.0
"""Megabytes by which the hostile run's memory may be above that of the drive alone."""
FULL, EMPTY = 60, 20
"""Scans and fixes in the node's queue at which the publisher waits, and until which."""
BATCH = 100
"""Messages after which it waits until the node has taken them: the middleware keeps as many as a
queue is deep, each in the room of the largest that it ever held."""
ALONE_RATE = 0.5
"""Of the drive's time, at which it is sent where nothing else is among it."""
START = 600.0
"""Seconds that the node has to start: one that was never run compiles first, on a busy machine for
minutes."""
LOOKS = 5
"""Diagnostics in which a node that is sent nothing tells of no more messages."""
LOOK = 0.2
"""Seconds between two looks at a program's memory."""
TYPES = {
    '/points_left': 'sensor_msgs/msg/PointCloud2',
    '/points_right': 'sensor_msgs/msg/PointCloud2',
    '/imu': 'sensor_msgs/msg/Imu',
    '/fix': 'sensor_msgs/msg/NavSatFix',
    TRUTH: 'nav_msgs/msg/Odometry',
}


@dataclass(frozen=True)
class Result:
    """What a program made of its input: end, memory in MB over time, and its files."""

    status: int
    printed: str
    memory: list[float]
    folder: Path

    @property
    def stats(self) -> dict[str, Any]:
        """``stats.json``; empty where there is none."""
        path = self.folder / 'stats.json'
        return json.loads(path.read_text()) if path.exists() else {}


Program: TypeAlias = Callable[[str, Sequence[Sent], float], Result]
"""Takes a folder's name, messages and the rate at which they come; returns what it made of them."""


class Memory:
    """Resident memory of a process, sampled until it is told to stop."""

    def __init__(self, pid: int) -> None:
        self.samples: list[float] = []
        self._path = Path(f'/proc/{pid}/status')
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.wait(LOOK):
            try:
                lines = self._path.read_text().splitlines()
            except OSError:
                return
            found = [line.split()[1] for line in lines if line.startswith('VmRSS')]
            self.samples += [int(found[0]) / 1024.0] if found else []

    def stop(self) -> list[float]:
        """End; returns the samples in MB."""
        self._done.set()
        self._thread.join()
        return self.samples


def write_bag(sent: Iterable[Sent], recording: Recording, folder: Path) -> Path:
    """A bag of raw messages, with the drive's settings.

    It is one that is read message by message; MCAP would be one chunk, which is read as a whole.
    """
    connections: dict[str, Any] = {}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        for item in sent:
            if item.topic not in connections:
                kind = TYPES[item.topic]
                connections[item.topic] = writer.add_connection(item.topic, kind, typestore=STORE)
            writer.write(connections[item.topic], item.logged, item.data)
    recording.write_settings(folder)
    return folder


def run_map(source: Path, out: Path) -> Result:
    """``map`` in a process of its own."""
    command = [sys.executable, '-m', 'incremental_mapper.cli.main', 'map', str(source), str(out)]
    with tempfile.TemporaryFile('w+') as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
        memory = Memory(process.pid)
        status = process.wait()
        samples = memory.stop()
        log.seek(0)
        return Result(status, log.read(), samples, out)


@contextmanager
def _node(settings: Path, out: Path, domain: int) -> Iterator[tuple[Any, Any, Path]]:
    """A node as a program, and a client that listens to it."""
    from incremental_mapper.ros.client import open_client
    from incremental_mapper.ros.programs import local_environment, node_command, running

    log = out.with_suffix('.log')
    given = {'diagnostics.period': 0.2, 'save.folder': out.absolute()}
    command = node_command([settings], given)
    with (
        log.open('w') as file,
        running(command, local_environment(domain), file, file) as process,
        open_client(domain) as client,
    ):
        client.wait(
            lambda: bool(client.diagnostics), 'the node', START, lambda: process.poll() is None
        )
        yield process, client, log


def run_node(sent: Sequence[Sent], settings: Path, out: Path, domain: int, rate: float) -> Result:
    """Publish messages into a node, in the time of the drive, and save its map."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with _node(settings, out, domain) as (process, client, log):
        memory = Memory(process.pid)
        began = time.monotonic()
        publish(sent, domain, rate, lambda: _waiting(client, process), Taken(client))
        pace = len(sent) / (time.monotonic() - began)
        status, said = 0, ''
        try:
            _settle(client)
            success, said = client.call('save_map', 300.0)
            status = 0 if success else 1
        except InputError as error:
            status, said = 1, str(error)
        if process.poll() is not None:
            status = process.returncode or 1
        samples = memory.stop()
        parts = client.diagnostics[-1]
    received = {name: parts[name]['received'] for name in parts if 'received' in parts[name]}
    print(f'{len(sent)} messages into the node, {pace:.0f} a second', flush=True)
    printed = f'{said}\nreceived {received}\nworker {parts["worker"]}\n' + log.read_text()
    saved = Path(said.removeprefix('saved to ').partition(';')[0]) if status == 0 else out
    return Result(status, printed, samples, saved)


def _waiting(client: Any, process: Any) -> int:
    """Scans and fixes that wait in the node; -1 where it has ended."""
    if process.poll() is not None:
        return -1
    return int(client.diagnostics[-1]['worker']['queue_core'])


class Taken:
    """Waits until the node has taken what it was sent; some of it no subscription can read."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._unread = 0

    def __call__(self, sent: int) -> None:
        """``sent`` are the messages so far."""
        before, same = -1, 0
        while same < LOOKS:
            parts = self._client.fresh_diagnostics(300.0)
            received = sum(part.get('received', 0) for part in parts.values())
            if received >= sent - self._unread:
                return
            same = same + 1 if received == before else 0
            before = received
        self._unread = sent - before


def _settle(client: Any) -> None:
    """Wait until the node has mapped what it was sent."""
    before = -1
    while True:
        parts = client.fresh_diagnostics(300.0)
        received = sum(part.get('received', 0) for part in parts.values())
        waiting = parts['worker']['queue_core'] + parts['worker']['queue_imu']
        if received == before and waiting == 0:
            break
        before = received
    client.call('flush', 300.0)


def publish(
    sent: Sequence[Sent],
    domain: int,
    rate: float,
    waiting: Callable[[], int] = lambda: 0,
    taken: Callable[[int], None] = lambda sent: None,
) -> None:
    """Send messages as they are, at ``rate`` times the pace at which they were recorded.

    More slowly where ``waiting``, what waits in the node, says so, and where ``taken``, which
    returns once the node has taken what it was sent, takes its time.
    """
    import rclpy
    from rclpy.context import Context
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from rclpy.signals import SignalHandlerOptions
    from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

    kinds = {'/imu': Imu, '/fix': NavSatFix}
    context = Context()
    rclpy.init(
        args=[],
        context=context,
        domain_id=domain,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    node = rclpy.create_node('fuzz', context=context, enable_rosout=False)
    quality = QoSProfile(depth=2000, reliability=ReliabilityPolicy.RELIABLE)
    publishers = {
        topic: node.create_publisher(kinds.get(topic, PointCloud2), topic, quality)
        for topic in KINDS
    }
    try:
        end = time.monotonic() + 60.0
        while any(p.get_subscription_count() == 0 for p in publishers.values()):
            if time.monotonic() > end:
                raise TimeoutError('the node does not listen')
            time.sleep(0.1)
        begin, first = time.monotonic(), sent[0].logged
        own = [item for item in sent if item.topic in publishers]
        for number, item in enumerate(own):
            wait = begin + (item.logged - first) / 1e9 / rate - time.monotonic()
            if wait > 0.001:
                time.sleep(wait)
            if waiting() > FULL or number % BATCH == BATCH - 1:
                taken(number)
                while waiting() > EMPTY:
                    time.sleep(LOOK)
                # Later messages keep their distance from this one.
                begin = time.monotonic() - (item.logged - first) / 1e9 / rate
            if waiting() < 0:
                raise InputError('the node has ended')
            publishers[item.topic].publish(item.data)
        time.sleep(2.0)
    finally:
        node.destroy_node()
        context.try_shutdown()


def apart(first: Path, second: Path) -> tuple[float, float, int]:
    """How two trajectories of one drive differ.

    Returns:
        RMS and largest distance in metres of the positions after a rigid fit, and how many poses
        were compared.
    """
    errors = trajectory_errors(read_tum(first), read_tum(second))
    if errors is None:
        return np.inf, np.inf, 0
    estimate, other = match_truth(read_tum(first), read_tum(second))
    distance = np.linalg.norm(estimate.positions - other.positions, axis=1)
    return errors.ate_rmse_m, float(distance.max()), len(estimate)


def report(name: str, alone: Result, among: Result, truth: Path) -> bool:
    """Print both runs; returns whether the hostile one is as good as the other."""
    print(f'\n## {name}\n\n| | status | clusters | ATE, m | memory, MB: 25 %, 50 %, 75 %, peak |')
    print('|---|---:|---:|---:|---|')
    for word, result in (('alone', alone), ('among hostile', among)):
        path = result.folder / 'trajectory.tum'
        errors = trajectory_errors(read_tum(path), read_truth(truth)) if path.exists() else None
        ate = '-' if errors is None else f'{errors.ate_rmse_m:.3f}'
        marks = [result.memory[len(result.memory) * n // 4] for n in (1, 2, 3)]
        marks = [*marks, max(result.memory)]
        clusters = result.stats.get('clusters', '-')
        memory = ', '.join(f'{mark:.0f}' for mark in marks)
        print(f'| {word} | {result.status} | {clusters} | {ate} | {memory} |')
    dropped: Counter[str] = Counter()
    for reasons in among.stats.get('dropped', {}).values():
        dropped.update(reasons)
    print('\nleft out: ' + ', '.join(f'{n} {reason}' for reason, n in dropped.most_common()))
    for item in among.stats.get('warnings', []):
        print(f'warning: {item["rule"]} {item["sensor"]}: {item["text"][:150]}')
    if alone.status or among.status or 'Traceback' in among.printed:
        print(among.printed[:1000], '...', among.printed[-3000:], sep='\n')
        return False
    paths = [result.folder / 'trajectory.tum' for result in (alone, among)]
    rms, most, count = apart(*paths)
    growth = max(among.memory) - max(alone.memory)
    print(f'trajectories: {rms:.4f} m apart (RMS of {count} poses after a fit), {most:.3f} at most')
    print(f'memory: {growth:+.0f} MB at the peak')
    return rms <= NOISE and growth <= GROWTH


def main() -> int:
    """Run the program; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument('--count', type=int, default=20_000, metavar='N')
    parser.add_argument('--seeds', default='1', metavar='N,N,...')
    parser.add_argument('--seconds', type=float, default=5.0, metavar='S')
    parser.add_argument('--only', choices=['map', 'node'])
    parser.add_argument('--rate', type=float, default=0.1, help='of the drive, into the node')
    parser.add_argument('--kinds', default='', metavar='REGEX', help='these hostile ones alone')
    parser.add_argument('--domain', type=int, metavar='N', help='ROS domain; a free one by default')
    parser.add_argument('--out', type=Path, metavar='FOLDER', help='keep everything here')
    args = parser.parse_args()
    work = args.out or Path(tempfile.mkdtemp(prefix='fuzz_'))
    try:
        return run(args, work)
    finally:
        if args.out is None:
            shutil.rmtree(work, ignore_errors=True)


def run(args: argparse.Namespace, work: Path) -> int:
    """Both halves for every seed; returns the exit status."""
    recording = _drive(args, work)
    truth = recording.folder / 'global_pose.csv'
    shutil.rmtree(work / 'alone', ignore_errors=True)
    alone = list(valid(recording))
    bag = write_bag(alone, recording, work / 'alone')
    programs = _programs(args, bag, work)
    base = {name: start('alone', alone, ALONE_RATE) for name, start in programs.items()}
    lines: list[str] = []
    good = True
    for seed in (int(word) for word in args.seeds.split(',')):
        chosen = re.compile(args.kinds)
        among = [
            item
            for item in mixed(recording, args.count, seed)
            if not item.kind or chosen.search(f'{item.topic} {item.kind}')
        ]
        kinds = Counter(item.kind for item in among if item.kind)
        print(f'\nseed {seed}: {kinds.total()} hostile messages of {len(kinds)} kinds')
        for name, start in programs.items():
            result = start(f'among_{seed}', among, args.rate)
            fine = report(f'{name}, seed {seed}', base[name], result, truth)
            good &= fine
            paths = [one.folder / 'trajectory.tum' for one in (base[name], result)]
            off = apart(*paths)[0] if all(path.exists() for path in paths) else np.inf
            growth = max(result.memory) - max(base[name].memory)
            verdict = 'ok' if fine else 'FAILS'
            lines.append(
                f'| {name} | {seed} | {result.status} | {off:.4f} | {growth:+.0f} | {verdict} |'
            )
            print(flush=True)
    print('\n| program | seed | status | trajectories apart, m | memory, MB | verdict |')
    print('|---|---:|---:|---:|---:|---|')
    print('\n'.join(lines))
    print('\n' + ('as it should be' if good else 'NOT as it should be'))
    return 0 if good else 1


def _drive(args: argparse.Namespace, work: Path) -> Recording:
    return make_drive(replace(DRIVES['curve'], seconds=args.seconds), work / 'drive')


def _programs(args: argparse.Namespace, settings: Path, work: Path) -> dict[str, Program]:
    """What takes messages: each by its name, called with a folder's name, messages and rate."""
    found: dict[str, Program] = {}
    if args.only != 'node':

        def with_map(name: str, sent: Sequence[Sent], _: float) -> Result:
            source, out = work / f'bag_{name}', work / f'map_{name}'
            for folder in (source, out):
                shutil.rmtree(folder, ignore_errors=True)
            try:
                return run_map(write_bag(sent, _drive(args, work), source), out)
            finally:
                shutil.rmtree(source)  # a gigabyte

        found['map'] = with_map
    if args.only != 'map':
        from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
        from incremental_mapper.ros.programs import free_domain

        domain = args.domain or free_domain()

        def with_node(name: str, sent: Sequence[Sent], rate: float) -> Result:
            return run_node(sent, settings / SETTINGS_FILE, work / f'node_{name}', domain, rate)

        found['node'] = with_node
    return found


if __name__ == '__main__':
    sys.exit(main())
