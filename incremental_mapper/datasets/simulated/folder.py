"""Write a simulated drive as a folder in the layout of KAIST Urban."""

import heapq
import itertools
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated import receiver as gnss
from incremental_mapper.datasets.simulated.imu import measured_samples
from incremental_mapper.datasets.simulated.lidar import Lidar, RayCaster, load_embree
from incremental_mapper.datasets.simulated.motion import Drive
from incremental_mapper.datasets.simulated.options import MIN_DURATION, SimulationOptions
from incremental_mapper.datasets.simulated.scene import Scene, make_scene
from incremental_mapper.datasets.simulated.sensors import (
    T_BASE_IMU,
    T_BASE_LEFT,
    T_BASE_RIGHT,
    T_BASE_VRS,
)
from incremental_mapper.datasets.simulated.speed import make_profile
from incremental_mapper.datasets.simulated.stamps import (
    CoreStamps,
    Stamps,
    core_stamps,
    imu_stamps,
    truth_stamps,
)
from incremental_mapper.errors import OutputError
from incremental_mapper.measurements import NANOSECONDS

Array = NDArray[np.float64]
Progress = Callable[[int], object]

CHUNK = 1000
MARK = 'simulation.json'
"""Holds the options of the drive; a folder with this file was written by a simulation."""
CALIBRATION = {
    'LeftVLP': T_BASE_LEFT,
    'RightVLP': T_BASE_RIGHT,
    'IMU': T_BASE_IMU,
    'VRS': T_BASE_VRS,
}
# Numbers that keep the random streams of the sensors apart.
MOTION, INERTIAL, GNSS, LIDAR = 3, 4, 5, 6


def simulate(out_dir: Path, options: SimulationOptions, progress: Progress | None = None) -> None:
    """Simulate a drive and write it as a KAIST folder.

    Args:
        out_dir: the folder. A simulated drive in it is replaced where ``options.overwrite`` says
            so; other files in it stay.
        options: scene, motion, length, seed.
        progress: called with the number of LiDAR scans written since the last call.

    Raises:
        InputError: the file of stamps cannot be used, or embreex is not installed.
        OutputError: the folder cannot be written, or holds something else.
    """
    load_embree()
    core = core_stamps(options)
    place = options.seed if options.scene_seed is None else options.scene_seed
    scene = make_scene(options.scene, place)
    drive = make_drive(scene, options, core)
    try:
        _prepare(out_dir, options.overwrite)
        _write_mark(out_dir / MARK, options, core)
        _write_calibration(out_dir / 'calibration')
        _write_rows(out_dir / 'global_pose.csv', _truth_rows(drive, core))
        _write_sensors(out_dir / 'sensor_data', drive, options, core)
        _write_scans(out_dir / 'sensor_data', scene, drive, options, core, progress)
    except OSError as error:
        raise OutputError(
            f'{error.filename or out_dir}: cannot be written ({error.strerror or error}); '
            'choose a folder that is writable and has space'
        ) from error


def make_drive(scene: Scene, options: SimulationOptions, core: CoreStamps) -> Drive:
    """The car's motion through ``scene`` over the time that the core stamps span."""
    rng = np.random.default_rng([options.seed, MOTION])
    duration = max(core.duration, MIN_DURATION)
    return Drive(scene, make_profile(options.motion, duration, scene.route, rng), rng)


def _prepare(out_dir: Path, overwrite: bool) -> None:
    """Make the folders; remove the scans of a former simulation, and nothing else."""
    if out_dir.exists() and not out_dir.is_dir():
        raise OutputError(f'{out_dir}: is a file; choose a folder')
    if out_dir.is_dir() and any(out_dir.iterdir()):
        if not overwrite:
            raise OutputError(f'{out_dir}: is not empty; choose another folder or add --force')
        ours = (out_dir / MARK).is_file()
        taken = [name for name in ('sensor_data', 'global_pose.csv') if (out_dir / name).exists()]
        if taken and not ours:
            raise OutputError(
                f'{out_dir}: holds {taken[0]} that no simulation wrote (there is no {MARK}); '
                'choose another folder'
            )
    for side in ('left', 'right'):
        scans = out_dir / 'sensor_data' / f'VLP_{side}'
        scans.mkdir(parents=True, exist_ok=True)
        listing = scans.with_name(f'VLP_{side}_stamp.csv')
        if listing.is_file():
            for stamp in filter(str.isdigit, listing.read_text(encoding='ascii').split()):
                (scans / f'{stamp}.bin').unlink(missing_ok=True)
    (out_dir / 'calibration').mkdir(exist_ok=True)


def _write_mark(path: Path, options: SimulationOptions, core: CoreStamps) -> None:
    facts = {
        'scene': options.scene.value,
        'motion': options.motion.value,
        'seed': options.seed,
        **({} if options.scene_seed is None else {'scene_seed': options.scene_seed}),
        'timing': options.timing.name if options.timing else None,
        'duration_s': core.duration,
        'scan_stamp': 'end of the sweep of 0.1 s; points are not deskewed',
        'global_pose': 'T_world_vehicle; x east, y north, z up, all in true metres',
    }
    path.write_text(json.dumps(facts, indent=2) + '\n', encoding='ascii')


def _write_calibration(folder: Path) -> None:
    for name, matrix in CALIBRATION.items():
        rotation = ' '.join(f'{value:.12f}' for value in matrix[:3, :3].ravel())
        translation = ' '.join(f'{value:.6f}' for value in matrix[:3, 3])
        text = f'Simulated T_vehicle_sensor\nR: {rotation}\nT: {translation}\n'
        (folder / f'Vehicle2{name}.txt').write_text(text, encoding='ascii')


def _write_sensors(
    folder: Path, drive: Drive, options: SimulationOptions, core: CoreStamps
) -> None:
    rng = np.random.default_rng([options.seed, INERTIAL])
    inertial = imu_stamps(core, rng)
    _write_rows(folder / 'xsens_imu.csv', _imu_rows(drive, core, inertial, rng))
    rng = np.random.default_rng([options.seed, GNSS])
    # A timing file says when there were fixes, so nothing is taken away from it.
    spells = [] if options.timing else gnss.make_spells(core.duration, rng)
    found = list(gnss.fixes(drive, _seconds(core, core.gnss), spells, rng))
    _write_rows(folder / 'vrs_gps.csv', (_fix_row(int(core.gnss[fix.index]), fix) for fix in found))
    stamps = {
        'velodyne_left': core.left,
        'velodyne_right': core.right,
        'imu': inertial,
        'vrs': core.gnss[[fix.index for fix in found]],
    }
    entries = heapq.merge(
        *(zip(of.tolist(), itertools.repeat(name)) for name, of in stamps.items())
    )
    _write_rows(folder / 'data_stamp.csv', (f'{stamp},{name}' for stamp, name in entries))
    _write_rows(folder / 'VLP_left_stamp.csv', map(str, core.left.tolist()))
    _write_rows(folder / 'VLP_right_stamp.csv', map(str, core.right.tolist()))


def _write_scans(
    folder: Path,
    scene: Scene,
    drive: Drive,
    options: SimulationOptions,
    core: CoreStamps,
    progress: Progress | None,
) -> None:
    caster = RayCaster(scene.mesh)
    phases = np.random.default_rng([options.seed, LIDAR]).uniform(0.0, 2.0 * np.pi, 2)
    sides = (('left', core.left, T_BASE_LEFT), ('right', core.right, T_BASE_RIGHT))
    for number, (side, stamps, mount) in enumerate(sides):
        lidar = Lidar(caster, drive, mount, float(phases[number]))
        for index, end in enumerate(_seconds(core, stamps).tolist()):
            # Each sweep has a random stream of its own and so depends on no other.
            rng = np.random.default_rng([options.seed, LIDAR, number, index])
            lidar.sweep(end, rng).tofile(folder / f'VLP_{side}' / f'{stamps[index]}.bin')
            if progress is not None:
                progress(1)


def _seconds(core: CoreStamps, stamps: Stamps) -> Array:
    """Time of the drive at ``stamps`` (N,), in seconds."""
    seconds: Array = (stamps - core.first) / NANOSECONDS
    return seconds


def _truth_rows(drive: Drive, core: CoreStamps) -> Iterator[str]:
    stamps = truth_stamps(core)
    for start in range(0, len(stamps), CHUNK):
        chunk = stamps[start : start + CHUNK]
        position, rotation = drive.poses(_seconds(core, chunk))
        matrices = np.concatenate(
            [rotation.as_matrix(), (position + gnss.ORIGIN_GRID)[:, :, None]], axis=2
        )
        for stamp, row in zip(chunk.tolist(), matrices.reshape(-1, 12), strict=True):
            yield f'{stamp},' + ','.join(f'{value:.12f}' for value in row)


def _imu_rows(
    drive: Drive, core: CoreStamps, stamps: Stamps, rng: np.random.Generator
) -> Iterator[str]:
    row = iter(stamps.tolist())
    for samples in measured_samples(drive, _seconds(core, stamps), rng):
        yaw_pitch_roll = samples.attitude.as_euler('ZYX')
        table = np.hstack(
            [
                samples.attitude.as_quat(),
                yaw_pitch_roll[:, ::-1],
                samples.gyro,
                samples.force,
                samples.field,
            ]
        )
        for values in table:
            yield f'{next(row)},' + ','.join(f'{value:.9f}' for value in values)


def _fix_row(stamp: int, fix: gnss.Fix) -> str:
    """The 18 columns of vrs_gps.csv.

    The grid coordinates are those of global_pose.csv, so both can be compared; they differ from
    true UTM by the grid's scale, 0.4 mm per metre from the world's origin.
    """
    grid = fix.position + gnss.ORIGIN_GRID
    values = [
        f'{stamp}',
        f'{fix.latitude:.11f}',
        f'{fix.longitude:.11f}',
        f'{grid[0]:.6f}',
        f'{grid[1]:.6f}',
        f'{fix.altitude:.6f}',
        f'{int(fix.state)}',
        f'{gnss.SATELLITES[fix.state]}',
        f'{gnss.DILUTION[fix.state]:.1f}',
        f'{fix.sigma:.3f}',
        f'{fix.sigma:.3f}',
        f'{fix.sigma * gnss.VERTICAL:.3f}',
        f'{int(fix.heading_valid)}',
        f'{fix.heading:.3f}',
        f'{fix.speed * gnss.KNOTS:.4f}',
        f'{fix.speed * 3.6:.4f}',
        'D' if fix.state is gnss.FixState.FIXED else 'A',
        f'{fix.altitude - gnss.GEOID:.6f}',
    ]
    return ','.join(values)


def _write_rows(path: Path, rows: Iterable[str]) -> None:
    with path.open('w', encoding='ascii', newline='\n') as file:
        file.writelines(f'{row}\n' for row in rows)
