"""Memory of the node on a long drive: what grows beyond the map itself.

    python benchmarks/node_soak.py WORK_DIR [--seconds 600] [--rate 5]
                                   [--config config/kaist.yaml] [--samples CSV]

Simulates a drive of that length into WORK_DIR once (600 s: about 3 GB, some minutes), and plays
it into a node at ``--rate`` times real time. The node's resident memory is sampled all along.
What is meant to grow is subtracted: points of the stored scans, voxels of the map that is shown,
and scans that wait in the bounded queue, which the node reports in /diagnostics; and clusters,
factors and rows, which it counts in ~/graph_stats and whose sizes are measured in this process
beforehand (graph_memory.py). Prints the gains of lines fitted to the second half of the drive,
in MB a minute of driving.
"""

import argparse
import csv
import sys
import time
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from graph_memory import graph_bytes, piece_sizes, resident
from node_runs import PATIENCE, Drive, make_drive, node_run

from incremental_mapper.errors import InputError, MapperError

MB = 1e6
SAMPLE = 0.5
"""Seconds between two samples."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Resident memory and what the node says of itself; ``drive_s`` is time of the drive mapped."""

    wall_s: float
    drive_s: float
    rss_mb: float
    scans_mb: float
    voxels_mb: float
    graph_mb: float
    queue_mb: float
    queue_core: int


def main() -> int:
    """Returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('work', type=Path, metavar='WORK_DIR')
    parser.add_argument('--seconds', type=float, default=600.0)
    parser.add_argument('--rate', type=float, default=5.0)
    parser.add_argument('--config', type=Path, default=Path('config/kaist.yaml'))
    parser.add_argument('--samples', type=Path, metavar='CSV', help='keep the samples')
    args = parser.parse_args()
    try:
        args.work.mkdir(parents=True, exist_ok=True)
        drive = make_drive(args.work, args.seconds, args.config)
        samples = soak(drive, args.rate, args.work / 'soak.log')
        if args.samples is not None:
            write_samples(args.samples, samples)
    except MapperError as error:
        print(f'{Path(__file__).name}: {error}', file=sys.stderr)
        return 1
    return 0


def soak(drive: Drive, rate: float, log: Path) -> list[Sample]:
    """Play the drive and print the fits; returns the samples."""
    samples: list[Sample] = []
    sizes = piece_sizes()
    begin = time.monotonic()
    with node_run(drive, log, {}) as run:

        def look() -> None:
            now = time.monotonic() - begin
            if run.client.stats and (not samples or now - samples[-1].wall_s >= SAMPLE):
                parts = run.client.diagnostics[-1]
                samples.append(
                    Sample(
                        wall_s=now,
                        drive_s=run.client.stats[-1]['drive_s'],
                        rss_mb=resident(run.pid) / MB,
                        scans_mb=parts['worker']['scans_mb'],
                        voxels_mb=parts['worker']['voxels_mb'],
                        graph_mb=graph_bytes(sizes, run.client.stats[-1]) / MB,
                        queue_mb=parts['worker']['queue_mb'],
                        queue_core=parts['worker']['queue_core'],
                    )
                )

        run.play(rate, look)
        run.catch_up()
        run.client.call('flush', PATIENCE)
        run.parts()
        look()
        worker = run.parts()['worker']
        print(f'\n## Soak: {drive.seconds:.0f} s of driving at {rate:g} times real time\n')
        print(f'Player: {run.player_said}')
        fullest = max(sample.queue_core for sample in samples)
        print(
            f'{worker["limited_windows"]} windows searched less, '
            f'{worker["merged_windows"]} merged, at most {fullest} scans and fixes waited\n'
        )
    print_fits(samples)
    return samples


def print_fits(samples: list[Sample]) -> float:
    """Slopes over the second half of the drive; returns that of memory beyond the map."""
    half = samples[-1].drive_s / 2
    late = [sample for sample in samples if sample.drive_s >= half]
    if len(late) < 5:
        raise InputError(f'only {len(late)} samples; take a longer drive')
    minutes = np.array([sample.drive_s for sample in late]) / 60.0
    total = np.array([sample.rss_mb for sample in late])
    stored = np.array([sample.scans_mb + sample.voxels_mb for sample in late])
    graph = np.array([sample.graph_mb for sample in late])
    queue = np.array([sample.queue_mb for sample in late])
    print('| second half of the drive | first | last | MB a minute of driving |')
    print('|---|---|---|---|')
    for name, values in (
        ('resident memory', total),
        ('points of scans, voxels of the map', stored),
        ('clusters, factors, rows', graph),
        ('scans that wait in the bounded queue', queue),
        ('resident memory without all of these', total - stored - graph - queue),
    ):
        slope, _ = np.polyfit(minutes, values, 1)
        print(f'| {name} | {values[0]:.0f} MB | {values[-1]:.0f} MB | {slope:+.2f} |')
    return float(slope)


def write_samples(path: Path, samples: list[Sample]) -> None:
    """Keep the samples as CSV."""
    with path.open('w', newline='') as file:
        writer = csv.writer(file)
        writer.writerow(field.name for field in fields(Sample))
        writer.writerows(map(astuple, samples))


if __name__ == '__main__':
    sys.exit(main())
