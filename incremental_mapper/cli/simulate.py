"""``incremental_mapper simulate``: write a simulated drive with ground truth."""

import argparse
from pathlib import Path
from typing import Any

from tqdm import tqdm

from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import (
    DEFAULT_DURATION,
    MotionKind,
    SceneKind,
    SimulationOptions,
)
from incremental_mapper.datasets.simulated.stamps import core_stamps
from incremental_mapper.errors import ConfigError


def add_parser(subparsers: Any) -> None:
    """Add the command to argparse's ``subparsers``."""
    parser = subparsers.add_parser(
        'simulate',
        description='Simulate a car with two tilted VLP-16, an IMU and a VRS-GNSS receiver and '
        'write its data and its true poses as a KAIST Urban folder.',
    )
    parser.add_argument('out_dir', type=Path, metavar='OUT_DIR', help='folder to write')
    parser.add_argument(
        '--scene',
        choices=[kind.value for kind in SceneKind],
        default=SceneKind.STREET.value,
        help='surroundings (default: %(default)s)',
    )
    parser.add_argument(
        '--motion',
        choices=[kind.value for kind in MotionKind],
        default=MotionKind.MIXED.value,
        help='how the speed changes (default: %(default)s)',
    )
    parser.add_argument(
        '--duration',
        type=float,
        metavar='S',
        help=f'seconds to drive (default: {DEFAULT_DURATION:g})',
    )
    parser.add_argument(
        '--seed', type=int, default=0, metavar='N', help='same seed, same drive (default: 0)'
    )
    parser.add_argument(
        '--scene-seed',
        type=int,
        metavar='N',
        help='seed of the surroundings alone: drives with seeds of their own in one place '
        '(default: that of --seed)',
    )
    parser.add_argument(
        '--timing',
        type=Path,
        metavar='CSV',
        help='take the stamps of scans and fixes from a file with the columns stamp_ns,sensor '
        '(left, right or gps); the drive lasts as long as they do',
    )
    parser.add_argument(
        '--force', action='store_true', help='replace an earlier simulated drive in OUT_DIR'
    )
    parser.set_defaults(func=run)


def run(args: argparse.Namespace) -> int:
    """Carry out the command; returns the exit status."""
    if args.timing is not None and args.duration is not None:
        raise ConfigError('--duration and --timing exclude each other; leave one of them out')
    options = SimulationOptions(
        scene=SceneKind(args.scene),
        motion=MotionKind(args.motion),
        duration=DEFAULT_DURATION if args.duration is None else args.duration,
        seed=args.seed,
        timing=args.timing,
        overwrite=args.force,
        scene_seed=args.scene_seed,
    )
    core = core_stamps(options)
    with tqdm(total=core.scans, unit='scan', desc='simulate', disable=None) as bar:
        simulate(args.out_dir, options, bar.update)
    print(
        f'{args.out_dir}: {core.scans} scans and {core.duration:.1f} s of '
        f'{options.motion.value} motion in the {options.scene.value} scene'
    )
    return 0
