"""Sessions against one drive, and a joint map against its runs, on drives whose truth is known.

    python benchmarks/sessions.py cut DRIVE FOLDER [--at 30] [--config config/kaist.yaml]
    python benchmarks/sessions.py joint MERGED DRIVE... [--singles RUN...]

``cut`` maps a KAIST folder in one go, and cut in two, the second part with ``--continue``, and
compares the errors. ``joint`` has the errors of a map that ``merge`` made of runs of the drives, in
that order, after one rigid fit of all of it, beside those of the single runs after one of each;
and how far its closures between runs are off, with their squared error in standard deviations for
each dimension (1 where the covariance is right).
"""

import argparse
import shutil
from bisect import bisect
from itertools import accumulate
from pathlib import Path

import gtsam
import numpy as np

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.offline_run import map_drive
from incremental_mapper.results.sessions.saved_run import read_saved_run
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory, fit_rigid, match_truth
from incremental_mapper.variables import cluster_of


def cut(folder: Path, out: Path, low: float, high: float) -> Path:
    """A KAIST folder of the seconds from ``low`` to ``high`` of another one; scans are links."""
    shutil.rmtree(out, ignore_errors=True)
    data = folder / 'sensor_data'
    shutil.copytree(folder / 'calibration', out / 'calibration')
    shutil.copy(folder / 'global_pose.csv', out)
    (out / 'sensor_data').mkdir()
    start = min(int(path.stem) for path in data.glob('VLP_*/*.bin'))
    first, last = (start + round(seconds * NANOSECONDS) for seconds in (low, high))
    for table in data.glob('*.csv'):
        lines = table.read_text().splitlines(keepends=True)
        kept = [line for line in lines if first <= int(line.split(',')[0]) < last]
        (out / 'sensor_data' / table.name).write_text(''.join(kept))
    for path in data.glob('VLP_*/*.bin'):
        if first <= int(path.stem) < last:
            link = out / 'sensor_data' / path.parent.name / path.name
            link.parent.mkdir(exist_ok=True)
            link.symlink_to(path.resolve())
    return out


def error(estimate: np.ndarray, truth: np.ndarray) -> float:
    """RMS distance, metres, of positions (N, 3) after a rigid fit."""
    T_truth_estimate = fit_rigid(estimate, truth)
    moved = estimate @ T_truth_estimate[:3, :3].T + T_truth_estimate[:3, 3]
    return float(np.sqrt(np.mean(np.sum((moved - truth) ** 2, axis=1))))


def compare_cut(drive: Path, folder: Path, at: float, config: Path) -> None:
    """Map a drive in one go and in two, and print the errors."""
    tree = read_yaml(config)
    halves = [
        cut(drive, folder / name, *span)
        for name, span in (('first', (0.0, at)), ('second', (at, 1e9)))
    ]
    one = map_drive(drive, folder / 'one', tree, force=True)
    map_drive(halves[0], folder / 'map_first', tree, force=True)
    going_on = merge(tree, {'session': {'continue': str(folder / 'map_first')}})
    two = map_drive(halves[1], folder / 'map_both', going_on, force=True)
    for name, run in (('one go', one), ('--continue', two)):
        stats = run.statistics.to_tree()
        print(
            f'{name}: ATE {stats["ate_rmse_m"]:.4f} m, RPE per second '
            f'{stats["rpe_per_second_translation_rmse_m"]:.4f} m, {stats["components"]} component'
        )


def compare_joint(joint: Path, drives: list[Path], singles: list[Path]) -> None:
    """Print the errors of a joint map, and of the runs that it was made of."""
    run = FinishedRun(joint)
    poses = {
        item['cluster']: (item['stamp_ns'], item['value'])
        for item in run.graph['variables']
        if item['kind'] == 'pose'
    }
    first, pairs = 0, []
    for session, drive in zip(run.stats['sessions'], drives, strict=True):
        own = sorted(poses[i] for i in range(first, first + session['clusters']))
        first += session['clusters']
        numbers = np.array([value for _, value in own])
        stamps = np.array([stamp for stamp, _ in own])
        made = Trajectory(stamps, numbers[:, :3], numbers[:, 3:])
        covered, truth = match_truth(made, read_truth(drive / 'global_pose.csv'))
        pairs.append((covered.positions, truth.positions))
        print(f'{drive}: of the joint map, fitted alone, {error(*pairs[-1]):.4f} m')
    for single, drive in zip(singles, drives, strict=False):
        truth = read_truth(drive / 'global_pose.csv')
        covered, known = match_truth(FinishedRun(single).trajectory, truth)
        print(f'{single}: by itself {error(covered.positions, known.positions):.4f} m')
    print(f'all: {error(*(np.vstack(side) for side in zip(*pairs, strict=True))):.4f} m')


def compare_closures(joint: Path, drives: list[Path]) -> None:
    """Print how far the closures between the runs of a joint map are off the truth."""
    result = read_saved_run(joint, MemoryStore()).result
    ends = list(accumulate(session.clusters for session in result.sessions))
    truths = [read_truth(drive / 'global_pose.csv') for drive in drives]
    apart, squares = [], []
    for factor in result.factors:
        ids = [cluster_of(key) for key in factor.keys]
        runs = [bisect(ends, number) for number in ids]
        if factor.kind is not FactorKind.CLOSURE or runs[0] == runs[1]:
            continue
        stamps = [result.clusters[number].cluster.stamp for number in ids]
        first, second = (
            gtsam.Pose3(truths[run].interpolate(np.array([stamp])).matrices()[0])
            for run, stamp in zip(runs, stamps, strict=True)
        )
        off = gtsam.Pose3.Logmap(first.between(second).between(factor.factor.measured()))
        noise = factor.factor.noiseModel()
        gaussian = noise.noise() if isinstance(noise, gtsam.noiseModel.Robust) else noise
        apart.append(off)
        squares.append(float(np.square(gaussian.whiten(off)).sum()) / 6.0)
    if apart:
        turned, moved = np.degrees(np.array(apart)[:, :3]), np.array(apart)[:, 3:]
        print(
            f'{len(apart)} closures between runs: off by {np.sqrt(np.mean(moved**2, axis=0))} m, '
            f'{np.sqrt(np.mean(turned**2, axis=0))} degrees RMS, {moved.mean(axis=0)} m in the '
            f'mean; normalised squared error {np.mean(squares):.2f}'
        )


def main() -> None:
    """Run what the words say."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest='command', required=True)
    one = commands.add_parser('cut')
    one.add_argument('drive', type=Path)
    one.add_argument('folder', type=Path)
    one.add_argument('--at', type=float, default=30.0)
    one.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    other = commands.add_parser('joint')
    other.add_argument('merged', type=Path)
    other.add_argument('drives', type=Path, nargs='+')
    other.add_argument('--singles', type=Path, nargs='+', default=[])
    args = parser.parse_args()
    if args.command == 'cut':
        compare_cut(args.drive, args.folder, args.at, args.config)
    else:
        compare_joint(args.merged, args.drives, args.singles)
        compare_closures(args.merged, args.drives)


if __name__ == '__main__':
    main()
