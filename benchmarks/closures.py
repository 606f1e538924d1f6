"""What loop closure is worth, and whether it ever closes what is no loop.

    python benchmarks/closures.py FOLDER [--drives DRIVE ...] [--scenes revisit terrace]
        [--duration 210] [--seed 51] [--kiss-slam PYTHON]

Simulates in FOLDER, where they are not there yet, a drive that passes the same streets again in
both directions and a drive past houses that are all alike; both have fixes in their first 20 s
alone. Each is mapped without closures and with them; so are the drives given. A closure is false
where it is more than a metre or 3 degrees off the truth. PYTHON is the interpreter of an
environment with kiss-slam from PyPI, which gets the first LiDAR's scans of the first drive, and
with them the truth of its mount.
"""

import argparse
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peers import hand_over

from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import SceneKind, SimulationOptions
from incremental_mapper.graph.factors import FactorKind
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.offline_run import Run, map_drive
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory, from_matrices
from incremental_mapper.variables import cluster_of

CONFIG = Path(__file__).parents[1] / 'config' / 'kaist.yaml'
RUNNER = Path(__file__).with_name('peer_runner.py')
SCENES = (SceneKind.REVISIT.value, SceneKind.TERRACE.value)
FIXES_FOR = 20.0
FALSE_TRANSLATION, FALSE_ROTATION = 1.0, 3.0
"""Metres and degrees."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """A run: its ATE in metres, its closures and which of them are false, and its seconds."""

    ate: float
    closures: int
    false: int
    worst: float
    told: dict[str, int]
    seconds: float


def simulated(folder: Path, scene: SceneKind, duration: float, seed: int) -> Path:
    """A simulated drive with fixes in its first seconds alone."""
    drive = folder / f'{scene.value}_{duration:g}_{seed}'
    if not drive.exists():
        whole = folder / f'{drive.name}_whole'
        simulate(
            whole, SimulationOptions(scene=scene, duration=duration, seed=seed, overwrite=True)
        )
        _cut_fixes(whole / 'sensor_data')
        whole.rename(drive)
    return drive


def _cut_fixes(sensors: Path) -> None:
    listing, fixes = sensors / 'data_stamp.csv', sensors / 'vrs_gps.csv'
    rows = listing.read_text(encoding='ascii').splitlines()
    last = int(rows[0].split(',')[0]) + FIXES_FOR * NANOSECONDS
    kept = [row for row in rows if not row.endswith(',vrs') or int(row.split(',')[0]) <= last]
    listing.write_text('\n'.join(kept) + '\n', encoding='ascii')
    rows = fixes.read_text(encoding='ascii').splitlines()
    kept = [row for row in rows if int(row.split(',')[0]) <= last]
    fixes.write_text('\n'.join(kept) + '\n', encoding='ascii')


def outcome(run: Run, truth: Trajectory) -> Outcome:
    """What a run is worth, by the truth."""
    clusters = run.result.clusters
    errors = []
    for factor in run.result.factors:
        if factor.kind is not FactorKind.CLOSURE:
            continue
        stamps = np.array([clusters[cluster_of(key)].cluster.stamp for key in factor.keys])
        first, second = truth.interpolate(stamps).matrices()
        measured = factor.factor.measured().matrix()
        off = np.linalg.inv(np.linalg.inv(first) @ second) @ measured
        turned = np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1.0) / 2.0, -1.0, 1.0)))
        errors.append((float(np.linalg.norm(off[:3, 3])), float(turned)))
    false = sum(moved > FALSE_TRANSLATION or turned > FALSE_ROTATION for moved, turned in errors)
    found = trajectory_errors(run.result.trajectory, truth)
    return Outcome(
        ate=float('nan') if found is None else found.ate_rmse_m,
        closures=len(errors),
        false=false,
        worst=max((moved for moved, _ in errors), default=0.0),
        told=run.result.statistics.closures,
        seconds=run.statistics.wall_s,
    )


def mapped(drive: Path, enabled: bool) -> Outcome:
    """Map a drive with closures or without."""
    tree = merge(read_yaml(CONFIG), {'closure': {'enabled': enabled}})
    truth = open_source(drive, tree).truth()
    if truth is None:
        raise SystemExit(f'{drive}: has no truth')
    return outcome(map_drive(drive, config=tree), truth)


def kiss_slam(drive: Path, python: Path) -> float:
    """ATE of kiss-slam over the first LiDAR's scans."""
    tree = read_yaml(CONFIG)
    source = open_source(drive, tree)
    truth = source.truth()
    assert truth is not None
    with tempfile.TemporaryDirectory() as folder:
        hand_over(list(source.measurements()), effective_config(source, tree, ''), Path(folder))
        out = Path(folder) / 'kiss-slam.npz'
        subprocess.run([python, RUNNER, 'kiss-slam', folder, out], check=True)
        found = np.load(out)
        errors = trajectory_errors(from_matrices(found['stamps'], found['poses']), truth)
    return float('nan') if errors is None else errors.ate_rmse_m


def main() -> None:
    """Map everything, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('folder', type=Path)
    parser.add_argument('--drives', type=Path, nargs='*', default=[])
    parser.add_argument('--scenes', nargs='*', default=list(SCENES), choices=SCENES)
    parser.add_argument('--duration', type=float, default=210.0)
    parser.add_argument('--seed', type=int, default=51)
    parser.add_argument('--kiss-slam', type=Path)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    made = [simulated(args.folder, SceneKind(it), args.duration, args.seed) for it in args.scenes]
    total = 0
    for drive in (*made, *args.drives):
        without, closed = mapped(drive, False), mapped(drive, True)
        total += closed.false
        print(
            f'{drive.name:32} ATE {without.ate:.4f} m without, {closed.ate:.4f} m with '
            f'{closed.closures} closures, {closed.false} false (worst {closed.worst:.2f} m off), '
            f'{without.seconds:.1f} s and {closed.seconds:.1f} s; {closed.told}',
            flush=True,
        )
    print(f'false closures in all: {total}')
    if args.kiss_slam is not None:
        revisit = simulated(args.folder, SceneKind.REVISIT, args.duration, args.seed)
        print(f'{revisit.name:32} ATE {kiss_slam(revisit, args.kiss_slam):.4f} m by kiss-slam')


if __name__ == '__main__':
    main()
