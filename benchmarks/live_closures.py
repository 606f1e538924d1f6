"""Closed loops in a growing map: what they do to the newest pose, and to the time of a window.

    python benchmarks/live_closures.py FOLDER [--scene revisit] [--duration 210] [--seed 51]
        [--seconds S] [--period 10] [--config config/kaist.yaml]

Simulates in FOLDER, where it is not there yet, a drive that passes the same streets again with
fixes in its first 20 s alone, and hands its measurements to the node's worker as fast as they were
taken; no middleware is in between. Prints, of the newest pose of each window, the error and the
squared error in standard deviations for each dimension (1 where the covariance is right), before
and after every correction; the seconds from the end of a window to its pose, while a search goes on
and while none does; and what the windows cost in the first tenth of the drive and in the last.

The clouds are kept in a file: a process that holds gigabytes takes long to fork, and a node holds
none of what is to come. Python's lock changes hands as in the node.
"""

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from closures import simulated
from numpy.typing import NDArray

from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.options import SceneKind
from incremental_mapper.garbage import search_little
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.measurements import NANOSECONDS, Measurement
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.ros.updates import News, Trouble, Update, WindowUpdate
from incremental_mapper.ros.worker import SWITCH, Worker
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory

CONFIG = Path(__file__).parents[1] / 'config' / 'kaist.yaml'
COLUMNS, ALIGNED = ('points', 'point_times', 'intensities'), 64
ANCHORED = 18.0
"""Seconds within which fixes tell where the map lies in the frame of the truth."""


@dataclass(slots=True)
class Heard:
    """What a worker told: poses, windows with the time they came, and remarks."""

    poses: list[tuple[float, PoseUpdate, bool]] = field(default_factory=list)
    windows: list[tuple[float, WindowUpdate]] = field(default_factory=list)
    said: list[tuple[int, str]] = field(default_factory=list)
    searching: bool = False

    def take(self, update: Update) -> None:
        """Called by the worker."""
        now = time.monotonic()
        if isinstance(update, PoseUpdate):
            searching = any(thread.name == 'loops' for thread in threading.enumerate())
            self.poses.append((now, update, searching))
        elif isinstance(update, WindowUpdate):
            self.windows.append((now, update))
        elif isinstance(update, News | Trouble):
            self.said.append((len(self.poses), update.message))


def on_disk(measurements: Iterable[Measurement]) -> list[Measurement]:
    """Measurements whose clouds lie in a file, from which they are read when they are due."""
    kept: list[tuple[Measurement, dict[str, tuple[Any, ...]]]] = []
    with tempfile.TemporaryFile() as file:
        for item in measurements:
            places: dict[str, tuple[Any, ...]] = {}
            for name in COLUMNS:
                column = getattr(item, name, None)
                if column is not None:
                    file.write(bytes(-file.tell() % ALIGNED))
                    places[name] = file.tell(), column.nbytes, column.dtype, column.shape
                    file.write(column.tobytes())
            kept.append((replace(item, **dict.fromkeys(places)), places))
        file.flush()
        whole = np.memmap(file, np.uint8, 'c').view(np.ndarray)

    def read(offset: int, size: int, kind: np.dtype, shape: tuple[int, ...]) -> np.ndarray:
        return whole[offset : offset + size].view(kind).reshape(shape)

    return [
        replace(item, **{name: read(*place) for name, place in places.items()})
        for item, places in kept
    ]


def played(measurements: Iterable[Measurement], worker: Worker) -> float:
    """Hand measurements over when they are due; returns the time that stands for stamp zero."""
    begin, first = 0.0, 0
    for measurement in measurements:
        if not first:
            begin, first = time.monotonic(), measurement.stamp
        due = begin + (measurement.stamp - first) / NANOSECONDS
        time.sleep(max(due - time.monotonic(), 0.0))
        worker.inbox.put(measurement)
    return begin - first / NANOSECONDS


def errors(heard: Heard, truth: Trajectory) -> NDArray[np.float64]:
    """Seconds, metres, degrees and normalised squared error of each newest pose (N, 4)."""
    rows, T_map_truth = [], gtsam.Pose3()
    first = heard.poses[0][1].newest.stamp
    for _, update, _ in heard.poses:
        newest = update.newest
        seconds = (newest.stamp - first) / NANOSECONDS
        true = gtsam.Pose3(truth.interpolate(np.array([newest.stamp])).matrices()[0])
        if seconds < ANCHORED:
            T_map_truth = newest.pose.compose(true.inverse())
        apart = newest.pose.localCoordinates(T_map_truth.compose(true))
        known = newest.covariance
        squared = np.nan if known is None else apart @ np.linalg.solve(known, apart) / 6.0
        turned = np.degrees(np.linalg.norm(apart[:3]))
        rows.append((seconds, float(np.linalg.norm(apart[3:])), float(turned), float(squared)))
    return np.array(rows)


def quantiles(values: NDArray[np.float64]) -> str:
    """Of seconds, in milliseconds."""
    if len(values) == 0:
        return 'none'
    p50, p90, p99 = 1e3 * np.percentile(values, [50, 90, 99])
    most = 1e3 * values.max()
    return f'p50 {p50:.0f}, p90 {p90:.0f}, p99 {p99:.0f}, most {most:.0f} ms of {len(values)}'


def main() -> None:
    """Play the drive, and print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--scene', default=SceneKind.REVISIT.value)
    parser.add_argument('--duration', type=float, default=210.0)
    parser.add_argument('--seed', type=int, default=51)
    parser.add_argument('--seconds', type=float, default=np.inf)
    parser.add_argument('--period', type=float, default=10.0, help='closure.live_period; 0: none')
    parser.add_argument('--config', type=Path, default=CONFIG)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    drive = simulated(args.folder, SceneKind(args.scene), args.duration, args.seed)
    tree = merge(read_yaml(args.config), {'closure': {'live_period': args.period}})
    source = open_source(drive, tree)
    truth = source.truth()
    if truth is None:
        raise SystemExit(f'{drive}: has no truth')
    config = effective_config(source, merge(tree, {'window': {'predict': True}}), '')
    sys.setswitchinterval(SWITCH)
    search_little()
    measurements = on_disk(source.measurements())
    last = measurements[0].stamp + min(args.seconds, 1e6) * NANOSECONDS
    heard = Heard()
    worker = Worker(config, heard.take)
    worker.start()
    zero = played((item for item in measurements if item.stamp <= last), worker)
    worker.begin_stop(600.0)
    worker.join()
    report(heard, errors(heard, truth), zero)


def report(heard: Heard, rows: NDArray[np.float64], zero: float) -> None:
    """Print it."""
    for place, said in heard.said:
        print(f'{rows[min(place, len(rows) - 1), 0]:6.1f} s  {said}')
        if said.startswith('loops closed') and 0 < place < len(rows):
            pair = rows[place - 1], rows[place]
            words = [f'{row[1]:.2f} m, {row[2]:.2f} deg, squared {row[3]:.2f}' for row in pair]
            print(f'          newest pose off by {words[0]} before; {words[1]} after')
    anchored = rows[:, 0] > ANCHORED
    print(
        f'newest poses: {np.sqrt(np.mean(rows[anchored, 1] ** 2)):.3f} m RMS, '
        f'normalised squared error {np.nanmedian(rows[anchored, 3]):.2f} in the middle, '
        f'{np.nanpercentile(rows[anchored, 3], 95):.2f} at 95 %'
    )
    ends = {update.newest.stamp: update for _, update, _ in heard.poses}
    late = np.array(
        [when - zero - update.newest.stamp / NANOSECONDS for when, update, _ in heard.poses]
    )
    searching = np.array([busy for _, _, busy in heard.poses])
    # The last one waits for what would follow, until somebody ends the drive.
    late, searching = late[:-1], searching[:-1]
    print(f'{len(ends)} poses; from the stamp of a pose to the pose')
    print(f'  while a search goes on: {quantiles(late[searching])}')
    print(f'  while none does:        {quantiles(late[~searching])}')
    windows = {item.newest.stamp: item.result.end for _, item in heard.windows if item.newest}
    stamps = [update.newest.stamp for _, update, _ in heard.poses[:-1]]
    waited = np.array([(windows[stamp] - stamp) / NANOSECONDS for stamp in stamps])
    print('of that, from the end of its window to the pose')
    print(f'  while a search goes on: {quantiles((late - waited)[searching])}')
    print(f'  while none does:        {quantiles((late - waited)[~searching])}')
    costs = np.array([update.result.row['window_s'] for _, update in heard.windows])
    tenth = max(len(costs) // 10, 1)
    first, end = costs[:tenth].mean(), costs[-tenth:].mean()
    print(f'windows: {1e3 * first:.1f} ms in the first tenth, {1e3 * end:.1f} ms in the last one')
    print(f'  ({end / first:.2f} times); {quantiles(costs)}')
    print(f'closures: {heard.windows[-1][1].stats["closures"]}')


if __name__ == '__main__':
    main()
