"""``incremental_mapper evaluate``: every strategy on every input, and the paper's table."""

import argparse
import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.cli import exit_status
from incremental_mapper.cli.workers_option import add_workers, check_workers, workers_of
from incremental_mapper.config import Tree
from incremental_mapper.datasets.open import read_truth
from incremental_mapper.errors import ConfigError
from incremental_mapper.evaluation.campaign import (
    Plan,
    evaluate,
    flagged,
    prepare_out_dir,
    unfinished,
)
from incremental_mapper.evaluation.jobs import Job, Outcome, Status, plan_jobs
from incremental_mapper.evaluation.record import Evaluation
from incremental_mapper.evaluation.table_files import Reference, read_csv, write_tables
from incremental_mapper.evaluation.table_text import plain_table
from incremental_mapper.evaluation.workers import Workers
from incremental_mapper.selection.strategies import labelled, strategy_names
from incremental_mapper.settings import make_config, merge, read_yaml
from incremental_mapper.visualization.extras import LIBRARIES, importable, left_out

STRATEGIES = 'base,mom,min_time_shift,min_solver_error,fewest'
DEFAULT_WIDTH = 100
"""Characters in a line where the output is no terminal."""


def add_parser(subparsers: Any) -> None:
    """Add the command to the ``argparse`` sub-parsers of the program."""
    parser = subparsers.add_parser(
        'evaluate',
        description='Map every input with every strategy and compare: the table of the paper on '
        'the terminal and as table.csv, table.md and table.tex, the page report.html, and the '
        'output of each run in DIR/<input>/<strategy>/. What is done already is not run again '
        'unless the input, the settings or the program changed.',
    )
    parser.add_argument(
        'inputs',
        type=Path,
        nargs='+',
        metavar='INPUT',
        help='KAIST folder, rosbag2, ROS 1 bag, or folder of .bin scans',
    )
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='folder to write into'
    )
    parser.add_argument(
        '--strategies',
        default=STRATEGIES,
        metavar='A,B,...',
        help='strategies in the order of the table; NAME@X is NAME with selection.tie_confidence '
        'X, so that mom@0,mom@0.5,mom@0.95 is a sweep (default: %(default)s)',
    )
    parser.add_argument(
        '--truth',
        type=Path,
        metavar='FILE',
        help="true poses of all inputs, TUM or KAIST's global_pose.csv (default: what each "
        'input holds)',
    )
    parser.add_argument(
        '--config', type=Path, metavar='YAML', help='settings, or a ROS parameter file'
    )
    parser.add_argument(
        '--by-motion',
        action='store_true',
        help='cut every drive into standing, acceleration, constant speed and deceleration, '
        'and give each its rows',
    )
    add_workers(parser, 'runs')
    parser.add_argument(
        '--reference',
        type=Path,
        metavar='CSV',
        help='a table.csv of an earlier call, or of published numbers, to stand beside in table.md',
    )
    parser.add_argument(
        '--reference-names',
        default='',
        metavar='OURS=THEIRS,...',
        help='which sequence of the reference goes with which input, where their names differ',
    )
    parser.add_argument(
        '--caption', default='', metavar='TEXT', help='what the table says of the drives'
    )
    parser.add_argument(
        '--verify',
        action='store_true',
        help='score every candidate by direct search too and report the agreement (slow)',
    )
    parser.add_argument(
        '--force',
        action='store_true',
        help='run everything again, and write into DIR although it holds something else',
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Run the command; 1 where a job failed or is not to be trusted.

    Raises MapperError where nothing can be run.
    """
    plan = _plan(args)
    reference = _reference(args.reference, args.reference_names, plan.jobs)
    todo = list(plan.jobs) if args.force else unfinished(plan.jobs)
    with workers_of(args) as workers:
        prepare_out_dir(plan.out_dir, args.inputs, args.force)
        evaluation = _evaluate(plan, todo, workers)
    table = write_tables(evaluation, plan.by_motion, reference)
    print(plain_table(table, shutil.get_terminal_size((DEFAULT_WIDTH, 0)).columns))
    _write_report(plan.out_dir)
    failed = any(outcome.status is Status.FAILED for outcome in evaluation.outcomes)
    return exit_status.FAILURE if failed or flagged(evaluation) else 0


def _evaluate(plan: Plan, todo: Sequence[Job], workers: Workers) -> Evaluation:
    """Run what is left, and tell of it on stderr."""
    count = len(plan.jobs)
    done = count - len(todo)
    if done:
        print(f'{done} of {count} jobs were already done', file=sys.stderr)
    with tqdm(total=count, initial=done, unit='job', desc='evaluate', disable=None) as bar:

        def tell(outcome: Outcome) -> None:
            if outcome.error is not None:
                job = f'{outcome.job.sequence}, {outcome.job.strategy}'
                bar.write(f'failed: {job}: {outcome.error}', file=sys.stderr)
            bar.update()

        try:
            return evaluate(plan, todo, workers, tell)
        except KeyboardInterrupt:
            left = len(unfinished(plan.jobs))
            bar.write(
                f'note: {count - left} of {count} jobs are done; the same call goes on from there',
                file=sys.stderr,
            )
            raise


def _plan(args: argparse.Namespace) -> Plan:
    strategies = tuple(dict.fromkeys(name.strip() for name in args.strategies.split(',')))
    for name in strategies:
        known, own = labelled(name)
        if known not in strategy_names():
            raise ConfigError(
                f'--strategies: {name!r} is none; known are {", ".join(strategy_names())}'
            )
        make_config(own, f'--strategies: {name}')
    check_workers(args)
    where = str(args.config or 'settings')
    tree: Tree = {} if args.config is None else read_yaml(args.config)
    if args.verify:
        tree = merge(tree, {'selection': {'verify': True}})
    make_config(tree, where)
    if args.truth is not None:
        read_truth(args.truth)  # a wrong file is told once, not by every job
    jobs = plan_jobs(args.inputs, args.out, strategies, tree, where, args.truth)
    return Plan(
        out_dir=args.out,
        jobs=tuple(jobs),
        strategies=strategies,
        settings=tree,
        settings_from=where,
        command=shlex.join(['incremental_mapper', *args.words]),
        caption=args.caption,
        by_motion=args.by_motion,
    )


def _reference(path: Path | None, names: str, jobs: Sequence[Job]) -> Reference | None:
    """The reference, if any; tells of inputs that have nothing in it."""
    pairs = dict(_pair(text) for text in names.split(',') if text.strip())
    if path is None:
        if pairs:
            raise ConfigError('--reference-names: there is no --reference; name one')
        return None
    reference = Reference(path.stem, tuple(read_csv(path)), pairs)
    ours, theirs = list(dict.fromkeys(job.sequence for job in jobs)), reference.sequences
    unknown = [(name, ours) for name in pairs if name not in ours]
    unknown += [(name, theirs) for name in pairs.values() if name not in theirs]
    for name, known in unknown:
        raise ConfigError(f'--reference-names: {name!r} is none of {", ".join(known)}')
    alone = len(ours) == len(theirs) == 1
    lone = [name for name in ours if name not in pairs and name not in theirs and not alone]
    if lone:
        example = f'{lone[0]}={theirs[0]}'
        print(
            f'note: --reference {path} has nothing of {", ".join(lone)}; it has '
            f'{", ".join(theirs)}; say which goes with which: --reference-names {example}',
            file=sys.stderr,
        )
    return reference


def _pair(text: str) -> tuple[str, str]:
    ours, equals, theirs = text.strip().partition('=')
    if not (ours and equals and theirs):
        raise ConfigError(f'--reference-names: {text!r} is no pair; expected OURS=THEIRS')
    return ours, theirs


def _write_report(out_dir: Path) -> None:
    missing = left_out(LIBRARIES)
    if missing is not None:
        print(f'note: {missing}', file=sys.stderr)
    if not (importable('report.html') and importable('pictures')):
        return
    from incremental_mapper.evaluation.report.page import write_report

    print(f'report: {write_report(out_dir)}')
