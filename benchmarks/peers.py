"""Odometry without fixes, side by side with rko_lio and kiss-icp on the same scans in the same run.

    python benchmarks/peers.py INPUT[=CONFIG.yaml] ... [--seconds 60] [--set KEY=VALUE]
        [--cache FOLDER]

INPUT is a bag or a KAIST folder. The peers are installed from PyPI into an environment of their
own below --cache, at the first run only. They run with their defaults and know the extrinsics; of
several LiDARs they get the first. Ours maps everything but the fixes (strategy base), with the
configuration given, and mends as ``map`` does what the data prove wrong; --set names further runs
of ours.

Drift is the error of motions over 10, 20, 50, 100, 200 and 400 m, as far as the truth is that
long, in m per 100 m; ATE is after the best rigid fit; seconds are those of the systems themselves,
with one thread each for what is ours, in which all its attempts count. Without truth, fixes tell
how far the end is from the start, and the error of that, per 100 m of the way between, stands for
drift.
"""

import argparse
import os
import subprocess
import tempfile
import time
import venv
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from odometry import changed

from incremental_mapper import __version__
from incremental_mapper.config import Config
from incremental_mapper.datasets.open import open_source
from incremental_mapper.frontend.gnss import Datum
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import (
    NANOSECONDS,
    GnssFix,
    ImuSample,
    LidarScan,
    Measurement,
)
from incremental_mapper.results.mending import MendError, mending
from incremental_mapper.results.opened_drive import Drive, effective_config
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory, from_matrices, match_truth

PEERS = {'rko_lio': 'rko_lio==0.4.0', 'kiss-icp': 'kiss-icp==1.3.0'}
LENGTHS = (10.0, 20.0, 50.0, 100.0, 200.0, 400.0)
"""Metres of the motions whose errors are drift."""
CACHE = Path(os.environ.get('XDG_CACHE_HOME', Path.home() / '.cache')) / 'incremental_mapper'
RUNNER = Path(__file__).with_name('peer_runner.py')


@dataclass(frozen=True, slots=True)
class Answer:
    """What a system made of an input, and the seconds that it took."""

    name: str
    trajectory: Trajectory
    seconds: float


def environment(cache: Path) -> Path:
    """The Python of the peers' environment, which is made where it is not there yet."""
    folder = cache / 'peers'
    python = folder / 'bin' / 'python'
    done = folder / 'installed.txt'
    wanted = '\n'.join(PEERS.values())
    if not done.exists() or done.read_text(encoding='utf-8') != wanted:
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([python, '-m', 'pip', 'install', '-qq', *PEERS.values()], check=True)
        done.write_text(wanted, encoding='utf-8')
    return python


@dataclass(frozen=True, slots=True)
class Mapped:
    """What an attempt of ours made."""

    result: MapResult


def ours(items: list[Measurement], drive: Drive, name: str) -> Answer:
    """Map everything but the fixes; anew, as ``map`` does, where the data prove a setting wrong."""
    sensors = [one for one in drive.source.info.counts if one != 'gps']
    spent = 0.0

    def attempt(drive: Drive, may_mend: bool) -> Mapped:
        nonlocal spent
        with closing(Mapper(drive.config, sensors)) as mapper:
            began = time.perf_counter()
            try:
                for item in items:
                    if not isinstance(item, GnssFix):
                        mapper.push(item)
                    if may_mend and mapper.mend:
                        raise MendError(mapper.mended)
                mapper.flush()
                if may_mend and mapper.mend:
                    raise MendError(mapper.mended)
                return Mapped(mapper.result())
            finally:
                spent += time.perf_counter() - began

    mapped = mending(drive, attempt)
    return Answer(name, mapped.result.trajectory, spent)


def hand_over(items: list[Measurement], config: Config, folder: Path) -> None:
    """Write the first LiDAR's scans and the IMU's samples for the peers."""
    lidar = min(item.sensor for item in items if isinstance(item, LidarScan))
    kinds, stamps, imu = [], [], []
    for number, item in enumerate(items):
        if isinstance(item, ImuSample):
            kinds.append(-1)
            imu.append(np.concatenate([item.gyro, item.acceleration]))
        elif isinstance(item, LidarScan) and item.sensor == lidar:
            times = np.zeros(len(item.points)) if item.point_times is None else item.point_times
            np.save(folder / f'{number}.npy', np.column_stack([item.points, times]))
            kinds.append(number)
            imu.append(np.zeros(6))
        else:
            continue
        stamps.append(item.stamp)
    np.savez(
        folder / 'events.npz',
        kinds=kinds,
        stamps=stamps,
        imu=np.array(imu).reshape(-1, 6),
        T_base_lidar=config.lidars[lidar].matrix(),
        T_base_imu=config.imu.matrix(),
    )


def peer(name: str, python: Path, folder: Path) -> Answer | str:
    """Run a peer; why it has no answer where it has none."""
    out = folder / f'{name}.npz'
    done = subprocess.run(
        [python, RUNNER, name, folder, out], capture_output=True, text=True, check=False
    )
    if done.returncode:
        return (done.stderr.strip().splitlines() or ['no answer'])[-1]
    found: Any = np.load(out)
    if len(found['stamps']) < 2:
        return 'no scan could be used'
    trajectory = from_matrices(found['stamps'], found['poses'])
    return Answer(f'{name} {found["version"]}', trajectory, float(found['seconds']))


def drift(estimate: Trajectory, truth: Trajectory) -> float:
    """Mean error of motions over ``LENGTHS`` in m per 100 m; NaN where the way is shorter."""
    covered, reference = match_truth(estimate, truth)
    ways = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(reference.positions, axis=0), axis=1)))
    own, true = covered.matrices(), reference.matrices()
    found = []
    for length in LENGTHS:
        for start, end in enumerate(np.searchsorted(ways, ways + length).tolist()):
            if end >= len(ways):
                break
            motion = np.linalg.inv(own[start]) @ own[end]
            error = np.linalg.inv(np.linalg.inv(true[start]) @ true[end]) @ motion
            found.append(100.0 * float(np.linalg.norm(error[:3, 3])) / length)
    return float(np.mean(found)) if found else float('nan')


def end_error(estimate: Trajectory, fixes: list[GnssFix], arm: NDArray[np.float64]) -> float:
    """Error of the distance from start to end by the fixes, m per 100 m of the way."""
    inside = [fix for fix in fixes if estimate.covers(np.array([fix.stamp])).all()]
    if len(inside) < 2:
        return float('nan')
    first = inside[0]
    datum = Datum(first.latitude, first.longitude, first.altitude)
    track = np.array([datum.enu(fix) for fix in inside])
    poses = estimate.interpolate(np.array([fix.stamp for fix in inside])).matrices()
    places = poses[:, :3, 3] + poses[:, :3, :3] @ arm
    way = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
    apart = [float(np.linalg.norm(line[-1] - line[0])) for line in (places, track)]
    return 100.0 * abs(apart[0] - apart[1]) / max(way, 1.0)


def row(answer: Answer, truth: Trajectory | None, end: float) -> str:
    """A line of the table."""
    if truth is None:
        return f'  {answer.name:44} {end:8.3f} (end)    -    {answer.seconds:8.2f}'
    errors = trajectory_errors(answer.trajectory, truth)
    ate = float('nan') if errors is None else errors.ate_rmse_m
    moved = drift(answer.trajectory, truth)
    return f'  {answer.name:44} {moved:8.3f}     {ate:8.4f} {answer.seconds:8.2f}'


def main() -> None:
    """Run every system over every input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('inputs', nargs='+', metavar='INPUT[=CONFIG.yaml]')
    parser.add_argument('--seconds', type=float, default=60.0, help='of each input')
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    parser.add_argument('--cache', type=Path, default=CACHE)
    args = parser.parse_args()
    python = environment(args.cache)
    print(f'{"":46} {"m/100 m":>8}     {"ATE m":>8} {"seconds":>8}')
    for text in args.inputs:
        path, _, config_file = text.partition('=')
        settings = read_yaml(Path(config_file)) if config_file else {}
        fixed = {'odometry': {'processes': False}, 'selection': {'strategy': 'base'}}
        source = open_source(Path(path), settings)
        truth = source.truth()
        items: list[Measurement] = []
        for item in source.measurements():
            if items and (item.stamp - items[0].stamp) / NANOSECONDS > args.seconds:
                break
            items.append(item)
        print(f'{path}, {(items[-1].stamp - items[0].stamp) / NANOSECONDS:.1f} s')
        config = effective_config(source, merge(settings, fixed), path)
        answers: list[Answer | str] = []
        for change in ['', *args.set]:
            tree = merge(changed(settings, change), fixed)
            name = f'incremental_mapper {__version__} {change}'
            own = effective_config(source, tree, path)
            answers.append(ours(items, Drive(source, own, truth, tree, path), name))
        with tempfile.TemporaryDirectory() as folder:
            hand_over(items, config, Path(folder))
            has_imu = any(isinstance(item, ImuSample) for item in items)
            for name in PEERS:
                if name == 'rko_lio' and not has_imu:
                    answers.append(f'{name}: needs an IMU, there is none')
                else:
                    found = peer(name, python, Path(folder))
                    answers.append(f'{name}: {found}' if isinstance(found, str) else found)
        fixes = [item for item in items if isinstance(item, GnssFix)]
        arm = config.gnss.matrix()[:3, 3]
        for answer in answers:
            if isinstance(answer, str):
                print(f'  {answer}')
            else:
                end = end_error(answer.trajectory, fixes, arm) if truth is None else 0.0
                print(row(answer, truth, end), flush=True)


if __name__ == '__main__':
    main()
