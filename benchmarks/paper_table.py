"""The paper's table on simulated drives that carry the real stamps of its twelve sequences.

    python benchmarks/paper_table.py TIMING_DIR WORK_DIR [--config config/kaist.yaml] [--verify]

TIMING_DIR holds files such as ``constant_speed_urban-26.csv`` with the columns stamp_ns,sensor.
Drives are simulated once into WORK_DIR and used again by later calls. Prints Markdown; the
paper's own numbers for "mom" stand beside ours.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from incremental_mapper.config import merge, read_yaml
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SceneKind, SimulationOptions
from incremental_mapper.evaluation.run import map_source, settle_config

STRATEGIES = ('base', 'mom', 'min_time_shift', 'min_solver_error')
MOTIONS = {
    'zero_speed': MotionKind.ZERO,
    'acceleration': MotionKind.ACCEL,
    'constant_speed': MotionKind.CONST,
    'deceleration': MotionKind.DECEL,
}
# The paper's rows for its own method: compression in percent, RPE in metres and degrees.
PAPER_MOM = {
    'zero_speed_urban-26': (31.17, 0.004, 0.013),
    'zero_speed_urban-33': (27.32, 0.009, 0.038),
    'zero_speed_urban-38': (16.59, 0.005, 0.021),
    'acceleration_urban-26': (41.22, 0.229, 0.792),
    'acceleration_urban-33': (32.05, 0.098, 1.276),
    'acceleration_urban-38': (23.58, 0.050, 0.329),
    'constant_speed_urban-26': (26.67, 0.144, 0.852),
    'constant_speed_urban-33': (40.78, 0.118, 0.329),
    'constant_speed_urban-38': (23.68, 0.216, 1.904),
    'deceleration_urban-26': (33.95, 0.052, 0.535),
    'deceleration_urban-33': (23.81, 0.157, 1.006),
    'deceleration_urban-38': (30.53, 0.055, 0.346),
}
COLUMNS = (
    ('clusters', 'clusters', 'd'),
    ('vertices', 'vertices', 'd'),
    ('factors', 'factors', 'd'),
    ('compression %', 'compression_vertices_percent', '.1f'),
    ('RPE m', 'rpe_translation_rmse_m', '.4f'),
    ('RPE deg', 'rpe_rotation_rmse_deg', '.3f'),
    ('RPE/s m', 'rpe_per_second_translation_rmse_m', '.3f'),
    ('ATE m', 'ate_rmse_m', '.3f'),
    ('time shift s', 'total_time_shift_s', '.3f'),
    ('solver error', 'solver_error', '.1f'),
    ('parts', 'components', 'd'),
    ('window ms', 'window_ms', '.0f'),
)


@dataclass(frozen=True, slots=True)
class Job:
    """One drive under one strategy."""

    drive: Path
    strategy: str
    config: Path | None
    verify: bool


def run(job: Job) -> dict[str, Any]:
    """Map one drive; returns its statistics."""
    tree = {} if job.config is None else read_yaml(job.config)
    chosen = {'selection': {'strategy': job.strategy, 'verify': job.verify}}
    tree = merge(tree, chosen)
    source = open_source(job.drive, tree)
    done = map_source(source, settle_config(source, tree, str(job.config)), source.truth())
    return {**done.stats, 'window_ms': 1e3 * done.stats['window_median_s']}


def drives(timing: Path, work: Path) -> Iterator[Path]:
    """Simulate the drives that are not there yet; the seed is the place in the sorted list."""
    for seed, csv in enumerate(sorted(timing.glob('*.csv')), start=11):
        drive = work / csv.stem
        if not (drive / 'global_pose.csv').exists():
            motion = MOTIONS[csv.stem.rsplit('_', 1)[0]]
            options = SimulationOptions(
                scene=SceneKind.STREET, motion=motion, seed=seed, timing=csv, overwrite=True
            )
            simulate(drive, options, None)
        yield drive


def main() -> None:
    """Run everything and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('timing', type=Path)
    parser.add_argument('work', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--strategies', default=','.join(STRATEGIES))
    parser.add_argument('--verify', action='store_true', help='compare fast with direct MOM')
    parser.add_argument('--jobs', type=int, default=2)
    args = parser.parse_args()
    strategies = args.strategies.split(',')
    jobs = [
        Job(drive, strategy, args.config, args.verify and strategy == 'mom')
        for drive in drives(args.timing, args.work)
        for strategy in strategies
    ]
    with ProcessPoolExecutor(args.jobs) as pool:
        results = list(zip(jobs, pool.map(run, jobs), strict=True))
    heads = ['sequence', 'strategy', *(name for name, _, _ in COLUMNS), 'paper %/m/deg']
    print('| ' + ' | '.join(heads) + ' |')
    print('|---' * len(heads) + '|')
    for job, stats in results:
        cells = [format(stats[key], form) for _, key, form in COLUMNS]
        paper = PAPER_MOM.get(job.drive.name) if job.strategy == 'mom' else None
        note = '' if paper is None else ' / '.join(str(value) for value in paper)
        print('| ' + ' | '.join([job.drive.name, job.strategy, *cells, note]) + ' |')
    for strategy in strategies:
        own = [stats for job, stats in results if job.strategy == strategy]
        cells = [
            format(mean(stats[key] for stats in own), '.1f' if form == 'd' else form)
            for _, key, form in COLUMNS
        ]
        paper = [f'{mean(column):.3f}' for column in zip(*PAPER_MOM.values(), strict=True)]
        note = ' / '.join(paper) if strategy == 'mom' else ''
        print('| ' + ' | '.join(['**mean**', strategy, *cells, note]) + ' |')
    checks = [stats['verification'] for _, stats in results if 'verification' in stats]
    if checks:
        windows = sum(check['windows_with_a_choice'] for check in checks)
        agreeing = sum(check['same_or_within_half_percent'] for check in checks)
        same = sum(check['same_winner'] for check in checks)
        worst = max(check['worst_regret_percent'] for check in checks)
        fast = mean(check['fast_ms_per_candidate'] for check in checks)
        direct = mean(check['direct_ms_per_candidate'] for check in checks)
        print(
            f'\nFast against direct MOM: the same winner, or one within 0.5 %, in {agreeing} of '
            f'{windows} windows (the same in {same}, worst {worst:.2f} %); {fast:.2f} ms against '
            f'{direct:.2f} ms a candidate, ratio {direct / fast:.1f}.'
        )


if __name__ == '__main__':
    main()
