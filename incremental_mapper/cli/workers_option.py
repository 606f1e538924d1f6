"""The options of commands whose work is done side by side."""

import argparse
import sys

from incremental_mapper.errors import ConfigError
from incremental_mapper.evaluation.workers import ClusterWorkers, LocalWorkers, Workers


def add_workers(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --jobs and --scheduler.

    Args:
        parser: That of the command.
        what: What is done side by side.
    """
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        '--jobs',
        type=int,
        default=1,
        metavar='N',
        help=f'{what} side by side, each in a process (default: %(default)s)',
    )
    workers.add_argument(
        '--scheduler',
        metavar='ADDRESS',
        help='run on the workers of a Dask cluster, such as tcp://host:8786, that see the same '
        'folders under the same paths',
    )


def check_workers(args: argparse.Namespace) -> None:
    """Raise ConfigError where the options have values that they cannot have."""
    if args.jobs < 1:
        raise ConfigError(f'--jobs is {args.jobs}; expected 1 or more')


def workers_of(args: argparse.Namespace) -> Workers:
    """Whoever does the work; raises ClusterError where there is no such cluster."""
    if args.scheduler is None:
        return LocalWorkers(args.jobs)
    cluster = ClusterWorkers(args.scheduler)
    if cluster.count == 0:
        print('note: the cluster has no workers yet; waiting for some', file=sys.stderr)
    return cluster
