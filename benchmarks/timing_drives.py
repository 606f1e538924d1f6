"""Simulated drives that carry the real stamps of the paper's twelve sequences.

    python benchmarks/timing_drives.py TIMING_DIR DRIVES_DIR

TIMING_DIR holds files such as ``constant_speed_urban-26.csv`` with the columns stamp_ns,sensor.
Drives that are there already are kept. ``make table`` evaluates them.
"""

import argparse
import sys
from pathlib import Path

from tqdm import tqdm

from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SceneKind, SimulationOptions
from incremental_mapper.errors import MapperError
from incremental_mapper.evaluation.segments import Motion, motion_of_name

MOTIONS = {
    Motion.ZERO: MotionKind.ZERO,
    Motion.ACCELERATION: MotionKind.ACCEL,
    Motion.CONSTANT: MotionKind.CONST,
    Motion.DECELERATION: MotionKind.DECEL,
}
FIRST_SEED = 11


def main() -> int:
    """Simulate what is missing; 1 where the stamps are not there."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('timing', type=Path, metavar='TIMING_DIR')
    parser.add_argument('drives', type=Path, metavar='DRIVES_DIR')
    parser.add_argument(
        '--first-seed',
        type=int,
        default=FIRST_SEED,
        metavar='N',
        help='seed of the first drive (default: %(default)s); other seeds make other streets',
    )
    args = parser.parse_args()
    # The seed is the place in the sorted list, so that figures can be compared with older ones.
    stamps = [
        (seed, path, motion)
        for seed, path in enumerate(sorted(args.timing.glob('*.csv')), start=args.first_seed)
        if (motion := motion_of_name(path.stem)[0]) is not None
    ]
    if not stamps:
        print(
            f'{args.timing}: holds no stamps of the paper; expected files such as '
            'constant_speed_urban-26.csv with the columns stamp_ns,sensor',
            file=sys.stderr,
        )
        return 1
    for seed, path, motion in tqdm(stamps, unit='drive', desc='simulate', disable=None):
        drive = args.drives / path.stem
        if drive.exists():
            continue
        # Under another name until it is whole, so that an interrupted call leaves no half drive.
        partial = args.drives / f'.{path.stem}'
        options = SimulationOptions(
            scene=SceneKind.STREET,
            motion=MOTIONS[motion],
            seed=seed,
            timing=path,
            overwrite=True,
        )
        try:
            simulate(partial, options)
            partial.rename(drive)
        except MapperError as error:
            print(error, file=sys.stderr)
            return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
