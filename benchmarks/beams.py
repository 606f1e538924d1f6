"""How fast drives with large scans are mapped: one spinning LiDAR of 64 or 128 beams on a car.

    python benchmarks/beams.py WORK [--seconds 30] [--heads 64 128] [--times 2] [--config YAML]

A head of 64 beams has some 120 000 points in a turn, one of 128 beams 2048 columns; both turn ten
times a second and tell the time of every point, the IMU measures at 100 Hz and the receiver once
a second. The bags are simulated into WORK and used again by the next run. Each is mapped so many
times by ``incremental_mapper map`` in a process of its own. Printed are points a scan, seconds
driven over seconds of mapping (``real_time_factor``), those of the whole command, the 99th
percentile of a window against its duration, and the error of the trajectory (ATE).
"""

import argparse
import csv
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.bag_writer import TOPICS, BagWriter, bag_settings, with_truth
from incremental_mapper.datasets.kaist_files import read_recording
from incremental_mapper.datasets.simulated.folder import make_drive, simulate
from incremental_mapper.datasets.simulated.lidar import Lidar, RayCaster
from incremental_mapper.datasets.simulated.options import MotionKind, SceneKind, SimulationOptions
from incremental_mapper.datasets.simulated.scene import make_scene
from incremental_mapper.datasets.simulated.stamps import core_stamps
from incremental_mapper.datasets.truth import find_truth
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.settings import write_ros_yaml

HEADS = {
    # Beams, the lowest and the highest in degrees, and columns: as an HDL-64E and an OS1-128.
    64: (-24.8, 2.0, 2083),
    128: (-22.5, 22.5, 2048),
}
T_BASE_LIDAR = np.array(
    [[1.0, 0.0, 0.0, 0.8], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.7], [0.0, 0.0, 0.0, 1.0]]
)
SEED = 3
SETTINGS = {'window': {'duration': 0.3}}
"""Of one LiDAR a window of 0.2 s holds two scans, see config/kitti.yaml."""


def main() -> None:
    """Simulate what is not there yet, and map it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('work', type=Path, metavar='WORK')
    parser.add_argument('--seconds', type=float, default=30.0)
    parser.add_argument('--heads', type=int, nargs='+', choices=HEADS, default=list(HEADS))
    parser.add_argument('--times', type=int, default=2)
    parser.add_argument('--config', type=Path, metavar='YAML')
    args = parser.parse_args()
    print('beams  points  real-time factor  whole command  window p99 s (of)  ATE m', flush=True)
    for beams in args.heads:
        bag = args.work / f'beams_{beams}_{args.seconds:g}'
        if not bag.exists():
            write(bag, beams, args.seconds)
        for number in range(args.times):
            out = args.work / f'run_{beams}_{number}'
            show(bag, beams, out, args.config)


def write(bag: Path, beams: int, seconds: float) -> None:
    """Simulate a drive through the street with one LiDAR on the roof, as a bag."""
    options = SimulationOptions(
        scene=SceneKind.STREET, motion=MotionKind.MIXED, duration=seconds, seed=SEED
    )
    bag.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=bag.parent) as scratch:
        folder = Path(scratch) / 'drive'
        simulate(folder, options)  # its IMU, its fixes and its truth; its scans are left
        recording = read_recording(folder)
        truth = find_truth([folder])
        assert truth is not None
        streams = {name: recording.streams[name] for name in ('left', 'imu', 'gnss')}
        extrinsics = {**recording.extrinsics, 'left': T_BASE_LIDAR}
        one = replace(recording, streams=streams, extrinsics=extrinsics)
        everything = with_truth(one, truth)
        made = Path(scratch) / 'bag'
        stamps = streams['left'].stamps
        scans = sweeps(options, beams, stamps)
        with BagWriter(made, list(everything.streams)) as writer:
            for stamp, sensor, index in everything.order({}):
                record = next(scans) if sensor == 'left' else everything.streams[sensor].load(index)
                writer.write(sensor, stamp, record)
        write_ros_yaml(made / SETTINGS_FILE, {**bag_settings(one), **SETTINGS}, 'Simulated.')
        made.rename(bag)


def sweeps(
    options: SimulationOptions, beams: int, stamps: NDArray[np.int64]
) -> Iterator[NDArray[np.float32]]:
    """Clouds (N, 5), x, y, z, intensity and seconds after the stamp, which is the sweep's end."""
    core = core_stamps(options)
    scene = make_scene(options.scene, options.seed)
    low, high, columns = HEADS[beams]
    elevations = np.radians(np.linspace(low, high, beams))
    drive = make_drive(scene, options, core)
    lidar = Lidar(RayCaster(scene.mesh), drive, T_BASE_LIDAR, 0.0, elevations, columns)
    for index, stamp in enumerate(stamps.tolist()):
        end = (stamp - core.first) / NANOSECONDS
        rng = np.random.default_rng([options.seed, beams, index])
        points, fired = lidar.timed_sweep(end, rng)
        yield np.column_stack([points, fired - end]).astype(np.float32)


def show(bag: Path, beams: int, out: Path, config: Path | None) -> None:
    """Map a bag and print a line of what it took."""
    command = [sys.executable, '-m', 'incremental_mapper.cli.main', 'map', str(bag), str(out)]
    command += ['--force'] + ([] if config is None else ['--config', str(config)])
    began = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    spent = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)
    stats = json.loads((out / 'stats.json').read_text(encoding='utf-8'))
    with (out / 'windows.csv').open(encoding='utf-8') as file:
        walls = [float(row['window_s']) for row in csv.DictReader(file)]
    worst = float(np.quantile(walls, 0.99))
    duration = stats['settings']['window']['duration']
    print(
        f'{beams:5}  {width_of(bag):6}  {stats["real_time_factor"]:16.1f}  '
        f'{stats["drive_s"] / spent:13.1f}  {worst:12.3f} ({duration:g})  '
        f'{stats["ate_rmse_m"]:.4f}',
        flush=True,
    )


def width_of(bag: Path) -> int:
    """Points of the first scan."""
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        clouds = [item for item in reader.connections if item.topic == TOPICS['left']]
        connection, _, data = next(reader.messages(clouds))
        return int(reader.deserialize(data, connection.msgtype).width)


if __name__ == '__main__':
    main()
