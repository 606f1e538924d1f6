"""How good the maps of drives with truth are, under several sets of settings side by side.

    python benchmarks/accuracy.py DRIVE... [--config config/kaist.yaml] [--set KEY=VALUE]
        [--strategies base mom]

Each --set names another run beside that of the settings as they are, see ``odometry.py``. Printed
are ATE and RPE per second in metres, by drive and as the mean over the drives.
"""

import argparse
from pathlib import Path

import numpy as np
from odometry import changed

from incremental_mapper.results.offline_run import map_drive
from incremental_mapper.settings import merge, read_yaml


def main() -> None:
    """Map every drive under every set of settings with every strategy."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drives', nargs='+', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--set', action='append', default=[], metavar='KEY=VALUE,...')
    parser.add_argument('--strategies', nargs='+', default=['base', 'mom'])
    args = parser.parse_args()
    tree = {} if args.config is None else read_yaml(args.config)
    for text in ['', *args.set]:
        settings = merge(changed(tree, text), {'odometry': {'processes': False}})
        for strategy in args.strategies:
            print(f'\n{text or "settings as they are"}, {strategy}\n{"drive":26}   ATE m  RPE/s m')
            rows = []
            for drive in args.drives:
                errors = map_drive(drive, config=settings, strategy=strategy).statistics.errors
                if errors is None:
                    raise SystemExit(f'{drive}: has no truth')
                rows.append((errors.ate_rmse_m, errors.rpe_per_second_translation_rmse_m))
                print(f'{drive.name:26} {rows[-1][0]:7.4f}  {rows[-1][1]:7.4f}', flush=True)
            print(f'{"mean":26} {np.mean(rows, axis=0)[0]:7.4f}  {np.mean(rows, axis=0)[1]:7.4f}')


if __name__ == '__main__':
    main()
