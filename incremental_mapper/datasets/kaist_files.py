"""The files of a KAIST Complex Urban folder as they are: stamps, raw rows and raw clouds.

Nothing is filtered here beyond lines and stamps that cannot be read; those are counted.
"""

import re
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.firing_order import TimedScans
from incremental_mapper.errors import InputError, MeasurementError
from incremental_mapper.geometry import nearest_rotation
from incremental_mapper.measurements import Drops, FixStatus, Vector

LIDARS = {'left': ('VLP_left', 'Vehicle2LeftVLP'), 'right': ('VLP_right', 'Vehicle2RightVLP')}
"""Folder and calibration file of each LiDAR."""
POINT_BYTES = 16
MAX_STAMP = 2**31 * 1_000_000_000
"""ROS stamps hold signed 32-bit seconds."""

_FIX_STATES = {1: FixStatus.FIX, 4: FixStatus.GBAS, 5: FixStatus.SBAS}


class Stream(Protocol):
    """One sensor's records, sorted by stamp; loaded one at a time."""

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps in nanoseconds, ascending; repeated ones stay."""

    def load(self, index: int) -> NDArray[np.floating]:
        """The raw record; raises MeasurementError where it cannot be read."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Rows of a CSV file: ``values`` is (M, columns), without the stamp."""

    stamps: NDArray[np.int64]
    values: Vector

    def load(self, index: int) -> NDArray[np.floating]:
        """Row ``index``, (columns,)."""
        row: Vector = self.values[index]
        return row


@dataclass(frozen=True, slots=True, eq=False)
class ScanFiles:
    """A folder of ``<stamp>.bin`` files."""

    sensor: str
    folder: Path
    stamps: NDArray[np.int64]

    def load(self, index: int) -> NDArray[np.floating]:
        """Points (N, 4) float32: x, y, z in metres in the LiDAR's frame, and reflectance."""
        stamp = int(self.stamps[index])
        path = self.folder / f'{stamp}.bin'
        try:
            data = path.read_bytes()
        except FileNotFoundError as error:
            raise MeasurementError('missing_file', f'{path}: does not exist') from error
        except OSError as error:
            raise MeasurementError(
                'unreadable', f'{path}: cannot be read ({error.strerror})'
            ) from error
        if len(data) % POINT_BYTES:
            raise MeasurementError(
                'truncated', f'{path}: has {len(data)} bytes, no multiple of {POINT_BYTES}'
            )
        return np.frombuffer(data, dtype='<f4').reshape(-1, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A KAIST folder: streams by sensor and the sensors' poses T_vehicle_sensor (4, 4)."""

    path: Path
    streams: dict[str, Stream]
    extrinsics: dict[str, Vector]
    drops: Drops = field(default_factory=Counter)
    notes: tuple[str, ...] = ()

    @property
    def lidars(self) -> list[str]:
        """Names of the LiDARs that are there."""
        return [name for name in LIDARS if name in self.streams]

    def order(self, offsets: Mapping[str, int]) -> Iterator[tuple[int, str, int]]:
        """(stamp, sensor, index into the sensor's stream) of every record, by stamp.

        ``offsets`` are nanoseconds that are added to the stamps of a sensor.
        """
        names = list(self.streams)
        stamps = np.concatenate(
            [self.streams[name].stamps + offsets.get(name, 0) for name in names]
        )
        owners = np.repeat(
            np.arange(len(names)), [len(self.streams[name].stamps) for name in names]
        )
        used = [0] * len(names)
        # Each stream is sorted, so that a stable sort keeps its records in their own order.
        for position in np.argsort(stamps, kind='stable'):
            owner = int(owners[position])
            yield int(stamps[position]), names[owner], used[owner]
            used[owner] += 1

    def span(self) -> tuple[int, int]:
        """First and last stamp."""
        ends = [(s.stamps[0], s.stamps[-1]) for s in self.streams.values() if len(s.stamps)]
        return int(min(first for first, _ in ends)), int(max(last for _, last in ends))


def imu_parts(row: NDArray[np.floating]) -> tuple[Vector, Vector, Vector]:
    """Gyro (rad/s), acceleration (m/s^2) and quaternion x, y, z, w of ``xsens_imu.csv``."""
    values = np.asarray(row, dtype=np.float64)
    return values[7:10], values[10:13], values[0:4]


def fix_parts(row: NDArray[np.floating]) -> tuple[float, float, float, FixStatus, Vector]:
    """Latitude, longitude (degrees), altitude (m), status and ENU covariance of ``vrs_gps.csv``.

    The altitude is above the geoid, not the ellipsoid; over one drive the two differ by a constant.
    """
    latitude, longitude, altitude = (float(row[column]) for column in (0, 1, 4))
    state = int(row[5]) if np.isfinite(row[5]) else 0
    sigma_north, sigma_east, sigma_up = (float(value) for value in row[8:11])
    covariance = np.diag(np.array([sigma_east, sigma_north, sigma_up]) ** 2)
    return latitude, longitude, altitude, _FIX_STATES.get(state, FixStatus.NO_FIX), covariance


def point_times(cloud: NDArray[np.floating]) -> NDArray[np.floating] | None:
    """Seconds (N,) after the stamp of a cloud's points; None where nothing tells them.

    Of single points they may be NaN. A bare folder's clouds (N, 4) have none.
    """
    times = cloud[:, 4:].ravel()
    return times if np.isfinite(times).any() else None


def is_kaist_folder(path: Path) -> bool:
    """Whether a folder has the layout of a KAIST sequence."""
    return (path / 'sensor_data').is_dir()


def read_recording(path: Path) -> Recording:
    """Read a KAIST folder's tables and calibration; clouds are left on the disk.

    Args:
        path: a folder with ``sensor_data`` and ``calibration`` in it.

    Returns:
        The streams of the sensors that are there; lines that are unusable are counted in it.

    Raises:
        InputError: it is no KAIST folder, holds no scans, or lacks a calibration.
    """
    if not is_kaist_folder(path):
        raise InputError(
            f'{path}: is no KAIST folder; expected sensor_data/ with VLP_left/ or VLP_right/, '
            'and calibration/ beside it'
        )
    drops: Drops = Counter()
    notes: list[str] = []
    streams: dict[str, Stream] = {}
    sensors = path / 'sensor_data'
    for name, (folder, _) in LIDARS.items():
        scans = _scan_files(name, sensors, folder, drops)
        if scans is None:
            notes.append(f'LiDAR {name}: {sensors / folder} has no scans')
        else:
            streams[name] = TimedScans(scans.stamps, scans.load)
    if not streams:
        raise InputError(
            f'{sensors}: holds no LiDAR scans; expected <stamp>.bin in VLP_left/ or VLP_right/'
        )
    # Eight columns are the first release of the data set: orientation without rates.
    tables = {
        'imu': ('xsens_imu.csv', 16, {8: 'no_gyro'}),
        'gnss': ('vrs_gps.csv', 11, {}),
    }
    for name, (file, columns, reasons) in tables.items():
        source = sensors / file
        if not source.is_file():
            notes.append(f'{name}: {source} is missing')
            continue
        table = read_table(source, columns, name, drops, reasons)
        if len(table.stamps) == 0:
            notes.append(f'{name}: {source} has no usable line')
            continue
        streams[name] = table
    calibrations = {name: file for name, (_, file) in LIDARS.items()}
    calibrations |= {'imu': 'Vehicle2IMU', 'gnss': 'Vehicle2VRS'}
    extrinsics = {
        name: read_extrinsic(path / 'calibration' / f'{calibrations[name]}.txt') for name in streams
    }
    return Recording(path, streams, extrinsics, drops, tuple(notes))


def read_scan_folder(path: Path) -> Recording:
    """Read a bare folder of ``<stamp>.bin`` files as the recording of one LiDAR, ``left``.

    Raises:
        InputError: there is no such file.
    """
    drops: Drops = Counter()
    scans = ScanFiles('left', path, _stamps_of_files('left', path, drops))
    if len(scans.stamps) == 0:
        raise InputError(f'{path}: holds no <stamp in ns>.bin file')
    note = 'no calibration: the LiDAR is taken to sit in base_link, unturned'
    return Recording(path, {'left': scans}, {'left': np.eye(4)}, drops, (note,))


def read_table(
    path: Path,
    columns: int,
    sensor: str,
    drops: Drops,
    reasons: Mapping[int, str] | None = None,
) -> Table:
    """Read a CSV of a stamp and numbers a line.

    Args:
        path: the file; stamps are whole nanoseconds.
        columns: numbers that a line has at least; more are left out.
        sensor: whose lines they are, for ``drops``.
        drops: bad lines are counted here, as ``bad_line`` or as ``reasons`` says.
        reasons: what a bad line is counted as, by its number of words.

    Returns:
        The rows (M, columns), sorted by stamp.

    Raises:
        InputError: the file cannot be read.
    """
    stamps, values = array('q'), array('d')
    try:
        with path.open(encoding='ascii', errors='replace') as file:
            for line in file:
                if not line.strip():
                    continue
                words = line.split(',')
                row = _parse(words, columns)
                if row is None:
                    drops[sensor, (reasons or {}).get(len(words), 'bad_line')] += 1
                    continue
                stamps.append(row[0])
                values.extend(row[1])
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    keys = np.array(stamps, dtype=np.int64)
    table = np.array(values, dtype=np.float64).reshape(len(keys), columns)
    order = np.argsort(keys, kind='stable')
    return Table(keys[order], table[order])


def read_extrinsic(path: Path) -> Vector:
    """Read a calibration file.

    Args:
        path: a file with the lines ``R:`` (nine numbers, row-major) and ``T:`` (three, metres).

    Returns:
        T_vehicle_sensor (4, 4).

    Raises:
        InputError: the file is missing, or a value is bad; it is named.
    """
    try:
        text = path.read_text(encoding='utf-8', errors='replace')
    except FileNotFoundError as error:
        raise InputError(
            f'{path}: does not exist; it is in the calibration archive of the sequence'
        ) from error
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    matrix = np.eye(4)
    rotation = _labelled(path, text, 'R', 9).reshape(3, 3)
    matrix[:3, 3] = _labelled(path, text, 'T', 3)
    try:
        matrix[:3, :3] = nearest_rotation(rotation)
    except ValueError as error:
        numbers = ' '.join(f'{value:g}' for value in rotation.ravel())
        raise InputError(f'{path}: R is {numbers}; {error}') from error
    return matrix


def _parse(words: list[str], columns: int) -> tuple[int, list[float]] | None:
    if len(words) < columns + 1:
        return None
    try:
        stamp = int(words[0])
        numbers = [float(word) for word in words[1 : columns + 1]]
    except ValueError:
        return None
    return (stamp, numbers) if 0 < stamp < MAX_STAMP else None


def _labelled(path: Path, text: str, label: str, count: int) -> Vector:
    match = re.search(rf'^\s*{label}\s*:(.*)$', text, flags=re.MULTILINE)
    words = match.group(1).split() if match else []
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        numbers = np.empty(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        found = match.group(0).strip() if match else 'nothing'
        raise InputError(
            f'{path}: expected a line "{label}:" with {count} numbers, found {found!r}'
        )
    return numbers


def _scan_files(name: str, sensors: Path, folder: str, drops: Drops) -> ScanFiles | None:
    """Scans of one LiDAR: the stamp file says which there should be, else the folder does."""
    if not (sensors / folder).is_dir():
        return None
    listing = sensors / f'{folder}_stamp.csv'
    stamps = np.empty(0, dtype=np.int64)
    if listing.is_file():
        stamps = read_table(listing, 0, name, drops).stamps
    if len(stamps) == 0:
        stamps = _stamps_of_files(name, sensors / folder, drops)
    else:
        _check_names(sensors / folder, listing, stamps)
    return ScanFiles(name, sensors / folder, stamps) if len(stamps) else None


def _check_names(folder: Path, listing: Path, stamps: NDArray[np.int64]) -> None:
    """Refuse a folder that has scans, but none under a name that its list tells."""
    found = sorted(path.name for path in folder.glob('*.bin'))
    if found and not any((folder / f'{stamp}.bin').exists() for stamp in stamps):
        raise InputError(
            f'{folder}: none of the {len(stamps)} scans that {listing.name} lists is there, such '
            f'as {stamps[0]}.bin; what is there is named otherwise, such as {found[0]}; rename '
            'each to its stamp in nanoseconds'
        )


def _stamps_of_files(name: str, folder: Path, drops: Drops) -> NDArray[np.int64]:
    stamps = []
    for path in folder.glob('*.bin'):
        # isdecimal() takes digits of other scripts too, which int() reads but the path would lose.
        if path.stem.isascii() and path.stem.isdecimal() and 0 < int(path.stem) < MAX_STAMP:
            stamps.append(int(path.stem))
        else:
            drops[name, 'bad_name'] += 1
    return np.sort(np.array(stamps, dtype=np.int64))
