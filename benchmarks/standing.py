"""How often the test for a vehicle that stands is wrong, on drives whose truth is known.

    python benchmarks/standing.py DRIVE... [--config config/kaist.yaml]

Each drive is mapped as ``map`` does. A window that was taken for a standing one although the
vehicle moved by more than --slow at its end is a false alarm; one during which it stood, and had
for a second, and which was not taken for one, is missed.
"""

import argparse
from pathlib import Path

import numpy as np

from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.offline_run import map_source
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.settings import read_yaml
from incremental_mapper.trajectory import Trajectory

PAUSE = NANOSECONDS
"""Nanoseconds after which a standing vehicle should have been noticed."""
STEP = NANOSECONDS // 20


def speeds(truth: Trajectory, stamps: np.ndarray) -> np.ndarray:
    """Speed (N,) m/s around stamps (N,) ns that the truth covers."""
    before = np.maximum(stamps - STEP, truth.stamps[0])
    after = np.minimum(stamps + STEP, truth.stamps[-1])
    way = truth.interpolate(after).positions - truth.interpolate(before).positions
    return np.linalg.norm(way, axis=1) / ((after - before) / NANOSECONDS)


def row(counts: np.ndarray) -> str:
    """Moving, false, standing and missed windows."""
    return '{:8} {:6} {:9} {:7}'.format(*counts)


def main() -> None:
    """Map the drives and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('drives', nargs='+', type=Path)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    parser.add_argument('--slow', type=float, default=0.05, help='m/s (default: %(default)s)')
    options = parser.parse_args()
    totals = np.zeros(4, dtype=int)
    print(f'{"drive":36} {"windows":>8} {"moving":>8} {"false":>6} {"standing":>9} {"missed":>7}')
    for path in options.drives:
        drive = open_drive(path, read_yaml(options.config), str(options.config))
        windows: list[WindowResult] = []
        map_source(drive.source, drive.config, observe=windows.append)
        truth = drive.truth
        assert truth is not None, f'{path} has no truth'
        used = [window for window in windows if window.row['core']]
        starts, ends = np.array([(window.start, window.end) for window in used]).T
        taken = np.array([window.joined > 0 for window in used])
        inside = truth.covers(ends) & truth.covers(starts - PAUSE)
        quiet = np.array(
            [
                (speeds(truth, np.arange(low - PAUSE, high, STEP)) < 0.01).all()
                for low, high in zip(starts[inside], ends[inside], strict=True)
            ],
            dtype=bool,
        )
        moving = speeds(truth, ends[inside]) > options.slow
        counts = np.array(
            [
                moving.sum(),
                (moving & taken[inside]).sum(),
                quiet.sum(),
                (quiet & ~taken[inside]).sum(),
            ]
        )
        totals += counts
        print(f'{path.name:36} {len(ends):8} {row(counts)}')
    print(f'{"all":36} {"":8} {row(totals)}')


if __name__ == '__main__':
    main()
