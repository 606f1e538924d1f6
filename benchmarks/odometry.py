"""What scan matching costs and how well it does on drives whose truth is known.

    python benchmarks/odometry.py DRIVE... [--config config/kaist.yaml] [--set KEY=VALUE] [--times]

Each --set names another run beside that of the settings as they are, such as
``--set odometry.voxel_size=1.0``; several changes of one run are joined by commas. Costs are
thread CPU time in ms a scan, with what went to the libraries by call; errors are the RMS over
the scans of each drive of T_previous_current against the truth, and their means over the drives.
--times gives the points of a simulated KAIST drive the times that their directions tell, as a
driver would have: such scans are deskewed. OMP_NUM_THREADS=1 keeps the figures comparable.
"""

import argparse
import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import small_gicp
import yaml
from kiss_icp.kiss_icp import KissICP

from incremental_mapper.datasets.open import open_source
from incremental_mapper.frontend.front_end import FrontEnd
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.measurements import NANOSECONDS, LidarScan
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory

SPIN = 2.0 * np.pi * 10.0
"""Angular speed of the simulated LiDAR, rad/s; its head turns clockwise."""
PARTS = (
    (small_gicp, 'KdTree'),
    (small_gicp, 'estimate_covariances'),
    (small_gicp, 'align'),
    (KissICP, 'register_frame'),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One drive under one set of settings; errors in metres and degrees, costs in ms a scan."""

    scans: int
    pairs: int
    metres: float
    degrees: float
    cost: float
    parts: Counter[str]
    notes: Counter[str]


def timed(function: Callable[..., Any], spent: Counter[str], name: str) -> Callable[..., Any]:
    """The same function; adds the seconds of CPU that it takes to ``spent``."""

    def call(*args: Any, **kwargs: Any) -> Any:
        start = time.thread_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent[name] += time.thread_time() - start

    return call


@contextlib.contextmanager
def watched() -> Iterator[Counter[str]]:
    """The seconds that the libraries' parts take within the block."""
    spent: Counter[str] = Counter()
    own = [(owner, name, getattr(owner, name)) for owner, name in PARTS]
    try:
        for owner, name, function in own:
            setattr(owner, name, timed(function, spent, name))
        yield spent
    finally:
        for owner, name, function in own:
            setattr(owner, name, function)


def with_times(scan: LidarScan) -> LidarScan:
    """The scan with the time of each point, which is in the order of firing, the last at the end.

    The directions of successive points tell how far the head had turned.
    """
    azimuth = np.unwrap(np.arctan2(scan.points[:, 1], scan.points[:, 0]).astype(np.float64))
    times = (azimuth[-1] - azimuth) / SPIN
    return replace(scan, point_times=times.astype(np.float32))


def measure(drive: Path, tree: dict[str, Any], times: bool, seconds: float) -> Outcome:
    """Run the front end over the scans of a drive, in this process: costs are its thread's."""
    tree = merge(tree, {'odometry': {'processes': False}})
    source = open_source(drive, tree)
    truth = source.truth()
    if truth is None:
        raise SystemExit(f'{drive}: has no truth')
    end = FrontEnd(effective_config(source, tree, str(drive)))
    found: list[PreparedScan] = []
    cost, first = 0.0, None
    with watched() as parts:
        for measurement in source.measurements():
            first = measurement.stamp if first is None else first
            if (measurement.stamp - first) / NANOSECONDS > seconds:
                break
            if isinstance(measurement, LidarScan):
                scan = with_times(measurement) if times else measurement
                start = time.thread_time()
                prepared = end.prepare((scan,))
                cost += time.thread_time() - start
                found += [item for item in prepared if isinstance(item, PreparedScan)]
    metres, degrees = errors(found, truth)
    return Outcome(
        scans=len(found),
        pairs=len(metres),
        metres=rms(metres),
        degrees=rms(degrees),
        cost=1e3 * cost / max(len(found), 1),
        parts=Counter({name: 1e3 * spent / max(len(found), 1) for name, spent in parts.items()}),
        notes=end.notes,
    )


def errors(found: list[PreparedScan], truth: Trajectory) -> tuple[list[float], list[float]]:
    """Errors of the motions between scans that the truth covers, metres and degrees."""
    metres, degrees = [], []
    for item in found:
        if item.previous is None or item.T_previous_current is None:
            continue
        stamps = np.array([item.previous, item.core.stamp])
        if truth.covers(stamps).all():
            before, after = (gtsam.Pose3(pose) for pose in truth.interpolate(stamps).matrices())
            error = before.between(after).between(item.T_previous_current)
            metres.append(float(np.linalg.norm(error.translation())))
            degrees.append(float(np.degrees(np.linalg.norm(gtsam.Rot3.Logmap(error.rotation())))))
    return metres, degrees


def rms(values: list[float]) -> float:
    """Root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values else float('nan')


def changed(tree: dict[str, Any], text: str) -> dict[str, Any]:
    """The settings with ``section.key=value,...`` laid over them."""
    for change in filter(None, text.split(',')):
        path, _, value = change.partition('=')
        part: Any = yaml.safe_load(value)
        for key in reversed(path.split('.')):
            part = {key: part}
        tree = merge(tree, part)
    return tree


def report(name: str, drives: list[Path], outcomes: list[Outcome]) -> None:
    """Print a run: each drive, their means, and where the time went."""
    print(f'\n{name}\n{"drive":26} scans pairs  RMS m   RMS deg  ms CPU  notes')
    for drive, one in zip(drives, outcomes, strict=True):
        notes = ', '.join(f'{note} {count}' for note, count in one.notes.items())
        print(
            f'{drive.name:26} {one.scans:5} {one.pairs:5} {one.metres:7.4f} {one.degrees:8.4f} '
            f'{one.cost:7.2f}  {notes}'
        )
    metres, degrees, cost = (
        np.nanmean([getattr(one, key) for one in outcomes]) for key in ('metres', 'degrees', 'cost')
    )
    scans = sum(one.scans for one in outcomes)
    print(f'{"mean":26} {scans:5} {"":5} {metres:7.4f} {degrees:8.4f} {cost:7.2f}')
    parts: Counter[str] = Counter()
    for one in outcomes:
        parts.update({key: value / len(outcomes) for key, value in one.parts.items()})
    shares = [f'{key} {value:.2f}' for key, value in parts.most_common()]
    print('ms a scan: ' + ', '.join([*shares, f'the rest {cost - sum(parts.values()):.2f}']))


def main() -> None:
    """Measure every drive under every set of settings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drives', nargs='+', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    parser.add_argument('--times', action='store_true', help='give the points their times')
    parser.add_argument('--seconds', type=float, default=np.inf, help='of each drive')
    args = parser.parse_args()
    tree = {} if args.config is None else read_yaml(args.config)
    for text in ['', *args.set]:
        own = changed(tree, text)
        outcomes = [measure(drive, own, args.times, args.seconds) for drive in args.drives]
        report(text or 'settings as they are', args.drives, outcomes)


if __name__ == '__main__':
    main()
