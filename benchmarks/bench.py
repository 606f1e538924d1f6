"""All figures of the mapper's speed in one table, each from this machine and this run.

    python benchmarks/bench.py WORK [--seconds 60] [--long 600] [--hour 60] [--config YAML]

WORK keeps the simulated drives between calls. ``--long`` is the drive on which growth is
measured, in seconds, and ``--hour`` the one whose memory is measured, in minutes: the long drive
repeated. 0 leaves a part out. Every part runs in a process of its own, one after the other, so
that memory is told apart and nothing competes for the cores.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from hour import hour

import incremental_mapper.mapping.mapper as mapper_module
from incremental_mapper.config import Config, Tree
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.datasets.source import Source
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.statistics import STAGES
from incremental_mapper.measurements import LidarScan, Measurement
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.selection.choice import Choice
from incremental_mapper.selection.strategies import Strategy, find_strategy
from incremental_mapper.selection.window_problem import WindowProblem
from incremental_mapper.settings import make_config, merge, read_yaml

SEED = 3
START_UP = 3.0
"""Seconds that the LiDARs' processes get to start, as before the first scan of a live drive."""
SIX = 6
"""LiDARs of the part that has 243 candidates a window: none of its scans share one."""


def drive(work: Path, seconds: float) -> Path:
    """A simulated drive with two VLP-16 at KAIST rates; made once."""
    folder = work / f'mixed{seconds:g}'
    if not (folder / 'global_pose.csv').exists():
        options = SimulationOptions(
            motion=MotionKind.MIXED, duration=seconds, seed=SEED, overwrite=True
        )
        simulate(folder, options)
    return folder


def opened(folder: Path, tree: Tree) -> tuple[Source, Any]:
    """The input and its settled settings."""
    source = open_source(folder, tree)
    return source, effective_config(source, tree, 'the settings')


def whole(folder: Path, tree: Tree) -> dict[str, Any]:
    """The whole pipeline on a drive: stages, real-time factor, growth, memory."""
    source, config = opened(folder, tree)
    run = map_source(source, config, source.truth())
    rows = [row for row in run.result.rows if row['core']]
    stages = {
        name: np.percentile([1e3 * row[f'{name}_s'] for row in rows], (50, 95, 99)).tolist()
        for name in (*STAGES, 'window')
    }
    seconds = sum(row['solve_s'] + row['score_s'] + row['candidates_s'] for row in rows)
    keys = ('wall_s', 'drive_s', 'real_time_factor', 'peak_rss_mb', 'compression_vertices_percent')
    stats = run.statistics.to_tree()
    return {
        **{key: stats[key] for key in keys},
        'stages': stages,
        'windows': len(rows),
        'candidates_per_second': stats['candidates_solved'] / seconds,
        'growth': stats['window_last_tenth_s'] / stats['window_first_tenth_s'],
        'rpe_m': stats.get('rpe_translation_rmse_m'),
    }


def scoring(folder: Path, tree: Tree) -> dict[str, Any]:
    """Fast against direct scoring, in windows of 0.3 s on the first 20 s of a drive."""
    tree = merge(tree, {'window': {'duration': 0.3}, 'selection': {'verify': True}})
    source, config = opened(folder, tree)
    mapper = Mapper(config, list(source.info.counts))
    for measurement in _first(source, 20.0):
        mapper.push(measurement)
    verification: dict[str, Any] = mapper.stats()['verification']
    return verification


class _Watched:
    """A strategy whose choices are made by a function of it and the window."""

    def __init__(
        self, strategy: Strategy, select: Callable[[Strategy, WindowProblem], Choice]
    ) -> None:
        self._strategy, self._select = strategy, select

    def select(self, problem: WindowProblem) -> Choice:
        return self._select(self._strategy, problem)

    def warm_up(self) -> None:
        self._strategy.warm_up()


def _watch_choices(select: Callable[[Strategy, WindowProblem], Choice]) -> None:
    """Let mappers that are made from now on choose by ``select``."""
    mapper_module.find_strategy = (  # type: ignore[attr-defined]
        lambda name: _Watched(find_strategy(name), select)
    )


def _with_most(problem: WindowProblem, candidates: int) -> WindowProblem:
    """A window of which so many candidates are enumerated before it is searched."""
    config = problem.config
    selection = config.selection.model_copy(update={'max_candidates': candidates})
    return replace(problem, config=config.model_copy(update={'selection': selection}))


def six_lidars(folder: Path, tree: Tree) -> dict[str, Any]:
    """Windows of six scans of six LiDARs: 243 candidates, all solved and scored."""
    source = open_source(folder, tree)
    sides = source.info.settings['lidars']
    names = [f'{side}_{turn}' for turn in range(SIX // 2) for side in sides['names']]
    lidars = {name: sides[name.rsplit('_', 1)[0]] for name in names}
    settings = {**source.info.settings, 'lidars': {'names': names, **lidars}}
    config = make_config(merge(settings, merge(tree, {'window': {'duration': 0.3}})))
    taken: list[float] = []

    def timed(strategy: Strategy, problem: WindowProblem) -> Choice:
        began = time.perf_counter()
        choice = strategy.select(problem)
        if choice.solved == 243:
            taken.append(time.perf_counter() - began)
        return choice

    _watch_choices(timed)
    mapper = _started(config, [*names, 'imu', 'gnss'])
    turns = dict.fromkeys(sides['names'], 0)
    for measurement in _first(source, 20.0):
        item: Measurement = measurement
        if isinstance(item, LidarScan):
            turn = turns[item.sensor] % (SIX // 2)
            turns[item.sensor] += 1
            item = replace(item, sensor=f'{item.sensor}_{turn}')
        mapper.push(item)
    return {
        'windows': len(taken),
        'ms': np.percentile(1e3 * np.array(taken), (50, 95, 100)).tolist() if taken else [],
        'within_half_a_second_percent': 100.0 * float(np.mean(np.array(taken) <= 0.5)),
    }


def lengths(folder: Path, tree: Tree) -> dict[str, Any]:
    """Windows of growing length on the first 40 s, with the default search."""
    rows = []
    for duration in (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.5, 0.75, 1.0):
        source, config = opened(folder, merge(tree, {'window': {'duration': duration}}))
        mapper = _started(config, list(source.info.counts))
        for measurement in _first(source, 40.0):
            mapper.push(measurement)
        done = [row for row in mapper.result().rows if row['core']]
        mapper.close()
        spent = [row['window_s'] for row in done]
        rows.append(
            {
                'duration_s': duration,
                'core': median(row['core'] for row in done),
                'most': max(row['core'] for row in done),
                'candidates': median(row['candidates_enumerated'] for row in done),
                'cut': sum(row['cut'] for row in done),
                'windows': len(done),
                'ms': np.percentile(1e3 * np.array(spent), (50, 99)).tolist(),
                'in_time_percent': 100.0 * float(np.mean(np.array(spent) < duration)),
            }
        )
    return {'rows': rows}


def search(folder: Path, tree: Tree) -> dict[str, Any]:
    """The search against the enumeration where both are possible (up to 7 elements)."""
    found: dict[str, Any] = {}
    for strategy in ('mom', 'min_solver_error', 'min_time_shift'):
        pairs: list[tuple[bool, float]] = []

        def both(strategy: Strategy, problem: WindowProblem, into: Any = pairs) -> Choice:
            full = strategy.select(_with_most(problem, 10_000))
            elements = len(problem.elements)
            if 2 < elements <= 7 and full.winner is not None and full.connected > 1:
                picked = strategy.select(_with_most(problem, 1))
                scores = {item.candidate: item.score for item in full.tried}
                own = scores.get(picked.winner) if picked.winner else None
                regret = np.inf if own is None or not full.score else own / full.score - 1.0
                into.append((picked.winner == full.winner, float(regret)))
            return full

        _watch_choices(both)
        for duration in (0.2, 0.3):
            settings = {'window': {'duration': duration}, 'selection': {'strategy': strategy}}
            source, config = opened(folder, merge(tree, settings))
            mapper = Mapper(config, list(source.info.counts))
            for measurement in _first(source, 30.0):
                mapper.push(measurement)
            mapper.close()
        regrets = np.array([regret for _, regret in pairs])
        found[strategy] = {
            'windows': len(pairs),
            'same_percent': 100.0 * float(np.mean([same for same, _ in pairs])),
            'within_1_percent': 100.0 * float(np.mean(regrets <= 0.01)),
            'worst_percent': 100.0 * float(regrets.max()),
        }
    return found


def _started(config: Config, sensors: list[str]) -> Mapper:
    """A mapper whose processes are there."""
    mapper = Mapper(config, sensors)
    time.sleep(START_UP)
    return mapper


def _first(source: Source, seconds: float) -> Iterator[Measurement]:
    start: int | None = None
    for measurement in source.measurements():
        start = measurement.stamp if start is None else start
        if measurement.stamp - start > seconds * 1e9:
            return
        yield measurement


def report(parts: dict[str, Any]) -> str:
    """The table, as Markdown."""
    lines = ['| what | figure |', '|---|---|']

    def line(name: str, text: str) -> None:
        lines.append(f'| {name} | {text} |')

    if done := parts.get('whole'):
        for stage, values in done['stages'].items():
            p50, p95, p99 = values
            line(f'{stage}, ms: p50 / p95 / p99', f'{p50:.1f} / {p95:.1f} / {p99:.1f}')
        line(
            'real-time factor',
            f'{done["real_time_factor"]:.2f} ({done["wall_s"]:.1f} s for {done["drive_s"]:.1f} s)',
        )
        line('candidates a second', f'{done["candidates_per_second"]:.0f}')
        line(
            'vertices saved, RPE',
            f'{done["compression_vertices_percent"]:.1f} %, {done["rpe_m"]:.4f} m',
        )
        line('peak memory', f'{done["peak_rss_mb"]:.0f} MB')
    if done := parts.get('scoring'):
        line(
            'fast and direct scoring, ms a candidate',
            f'{done["fast_ms_per_candidate"]:.3f} and {done["direct_ms_per_candidate"]:.2f}: '
            f'ratio {done["direct_over_fast"]:.1f}',
        )
        line(
            'same winner, or one within 0.5 % by direct score',
            f'{done["agreement_percent"]:.1f} % of {done["windows_with_a_choice"]} windows, '
            f'worst {done["worst_regret_percent"]:.2f} %',
        )
    if done := parts.get('six_lidars'):
        p50, p95, most = done['ms']
        line(
            '243 candidates solved and scored, ms: p50 / p95 / most',
            f'{p50:.0f} / {p95:.0f} / {most:.0f} ({done["windows"]} windows, '
            f'{done["within_half_a_second_percent"]:.0f} % within 0.5 s)',
        )
    for strategy, done in parts.get('search', {}).items():
        line(
            f'search against enumeration up to N = 7, {strategy}',
            f'same winner in {done["same_percent"]:.1f} %, within 1 % in '
            f'{done["within_1_percent"]:.1f} % of {done["windows"]} windows, '
            f'worst {done["worst_percent"]:.2f} %',
        )
    if done := parts.get('long'):
        line(
            f'last tenth over first tenth of {done["drive_s"]:.0f} s',
            f'{done["growth"]:.2f}; real-time factor {done["real_time_factor"]:.2f}, '
            f'p99 of a window {done["stages"]["window"][2]:.1f} ms',
        )
    if done := parts.get('hour'):
        line(
            f'peak memory of {done["minutes"]:.0f} minutes',
            f'{done["peak_rss_mb_while_mapping"]:.0f} MB while mapping, growing by '
            f'{done["mb_a_minute"]:.1f} MB a minute in the second half, '
            f'{done["all_processes_mb_while_mapping"]:.0f} MB with its processes, '
            f'{done["peak_rss_mb_with_final_solve"]:.0f} MB with the final solve of '
            f'{done["final_s"]:.0f} s; growth {done["growth"]:.2f}, real-time factor '
            f'{done["real_time_factor"]:.2f}, closures {done["closures"]}',
        )
    if done := parts.get('lengths'):
        lines += [
            '',
            '| window s | N median / most | candidates | searched | ms p50 / p99 | in time |',
            '|---|---|---|---|---|---|',
        ]
        for row in done['rows']:
            p50, p99 = row['ms']
            lines.append(
                f'| {row["duration_s"]:g} | {row["core"]:g} / {row["most"]} | '
                f'{row["candidates"]:g} | {row["cut"]} of {row["windows"]} | '
                f'{p50:.0f} / {p99:.0f} | {row["in_time_percent"]:.0f} % |'
            )
    return '\n'.join(lines)


def main() -> None:
    """Run all parts, or one of them for the parent process."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('work', type=Path)
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--long', type=float, default=600.0)
    parser.add_argument('--hour', type=float, default=60.0)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    parser.add_argument('--only', help='one part, as JSON on the last line')
    args = parser.parse_args()
    tree = read_yaml(args.config)
    names = ['whole', 'scoring', 'six_lidars', 'search', 'lengths']
    if args.only is None:
        names += ['long'] * (args.long > 0) + ['hour'] * (args.hour > 0)
        drive(args.work, args.seconds)
        if args.long > 0 or args.hour > 0:
            drive(args.work, args.long or args.seconds)
        parts, failed = {}, list[str]()
        for name in names:
            print(f'{name} ...', file=sys.stderr, flush=True)
            call = [sys.executable, __file__, str(args.work), '--only', name]
            call += ['--seconds', str(args.seconds), '--long', str(args.long)]
            call += ['--hour', str(args.hour), '--config', str(args.config)]
            done = subprocess.run(call, capture_output=True, text=True)
            if done.returncode:
                print(done.stderr, file=sys.stderr)
                failed.append(name)
                continue
            parts[name] = json.loads(done.stdout.splitlines()[-1])
        print(report(parts))
        sys.exit(f'failed: {", ".join(failed)}' if failed else 0)
    short = drive(args.work, args.seconds)
    if args.only == 'long':
        done = whole(drive(args.work, args.long), tree)
    elif args.only == 'hour':
        done = hour(*opened(drive(args.work, args.long or args.seconds), tree), args.hour)
    else:
        made = {
            'whole': whole,
            'scoring': scoring,
            'six_lidars': six_lidars,
            'search': search,
            'lengths': lengths,
        }
        done = made[args.only](short, tree)
    print(json.dumps(done))


if __name__ == '__main__':
    main()
