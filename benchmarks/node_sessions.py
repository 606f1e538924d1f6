"""A drive through the node in one go and cut in two, the second part with ``session.continue``.

    python benchmarks/node_sessions.py DRIVE FOLDER [--at 30] [--config config/kaist.yaml]

Plays a KAIST folder in real time to a node that then saves its map, then the parts of it to
two nodes one after the other, and prints the errors of what they saved. Exit status 1 where the two
parts did not become one component, or their error is more than 1.1 times that of one go.
"""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from shutil import rmtree

import numpy as np
from node_runs import Drive, node_run
from sessions import cut

from incremental_mapper.cli.convert import convert
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.settings import read_yaml

LARGEST = 1.1
"""The error in two parts over that in one go."""


def as_bag(drive: Path, bag: Path, config: Path) -> Drive:
    """The bag of a KAIST folder, made anew."""
    convert(drive, bag, force=True)
    info = open_source(bag, read_yaml(config)).info
    return Drive(bag, (bag / SETTINGS_FILE, config), dict(info.counts), info.duration)


def saved(drive: Drive, folder: Path, parameters: Mapping[str, object]) -> FinishedRun:
    """Play a drive to a node of its own; the map that it saved."""
    rmtree(folder, ignore_errors=True)
    with node_run(drive, folder.with_suffix('.log'), parameters) as run:
        run.play(1.0)
        run.catch_up()
        ok, message = run.client.call('save_map', 600.0)
    if not ok:
        raise SystemExit(f'{drive.bag}: {message}')
    return FinishedRun(folder)


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drive', type=Path)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--at', type=float, default=30.0)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    args = parser.parse_args()
    folder = args.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    spans = {'one': (0.0, 1e9), 'first': (0.0, args.at), 'second': (args.at, 1e9)}
    maps: dict[str, FinishedRun] = {}
    for name, span in spans.items():
        drive = as_bag(cut(args.drive, folder / name, *span), folder / f'{name}_bag', args.config)
        parameters: dict[str, object] = {'save.folder': folder / f'map_{name}'}
        if name == 'second':
            parameters['session.continue'] = maps['first'].folder
        maps[name] = saved(drive, folder / f'map_{name}', parameters)
    truth = read_truth(args.drive / 'global_pose.csv')
    errors: list[float] = []
    for name in ('one', 'second'):
        run = maps[name]
        found = trajectory_errors(run.trajectory, truth)
        errors.append(np.inf if found is None else found.ate_rmse_m)
        joined = [item.get('joined_by') for item in run.stats.get('sessions', [])]
        print(
            f'{name}: ATE {errors[-1]:.4f} m, {run.stats["components"]} component, '
            f'{len(run.trajectory.stamps)} poses, sessions joined by {joined}',
            flush=True,
        )
    whole = maps['second'].stats['components'] == 1 and errors[1] <= LARGEST * errors[0]
    print(f'ratio {errors[1] / errors[0]:.2f}: {"as it should be" if whole else "NOT as asked"}')
    return 0 if whole else 1


if __name__ == '__main__':
    sys.exit(main())
