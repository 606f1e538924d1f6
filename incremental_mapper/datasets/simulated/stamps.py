"""When the sensors of a simulated drive measure: stamps in integer nanoseconds."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated.options import MAX_DURATION, SimulationOptions
from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS

Stamps = NDArray[np.int64]

COLUMNS = ('stamp_ns', 'sensor')
SENSORS = ('left', 'right', 'gps')
START = 1_544_581_126 * NANOSECONDS
LIDAR_PERIOD = 100_858_000
LIDAR_JITTER = 20_000
RIGHT_AFTER_LEFT = 27_300_000
FIX_JITTER = 900_000
IMU_PERIOD = 10_000_000
IMU_JITTER = 100_000
TRUTH_PERIOD = 10_000_000
BEFORE = 200_000_000
"""The IMU starts so many nanoseconds before the first core measurement."""
AFTER = 100_000_000
MIN_STAMP, MAX_STAMP = 10**17, 2**31 * NANOSECONDS
"""From 1973 on, so that seconds or milliseconds are not taken for nanoseconds,
to the last second that a ROS stamp can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class CoreStamps:
    """Stamps of the LiDAR sweeps (their ends) and of the fixes, each strictly increasing."""

    left: Stamps
    right: Stamps
    gnss: Stamps

    @property
    def first(self) -> int:
        """The earliest core measurement; time 0 of the drive."""
        return min(int(stamps[0]) for stamps in self._present())

    @property
    def last(self) -> int:
        """The latest core measurement."""
        return max(int(stamps[-1]) for stamps in self._present())

    @property
    def duration(self) -> float:
        """Seconds from the first to the last core measurement."""
        return (self.last - self.first) / NANOSECONDS

    @property
    def scans(self) -> int:
        """How many sweeps there are."""
        return len(self.left) + len(self.right)

    def _present(self) -> list[Stamps]:
        return [stamps for stamps in (self.left, self.right, self.gnss) if len(stamps)]


def core_stamps(options: SimulationOptions) -> CoreStamps:
    """Stamps from the timing file, or in the pattern of a KAIST drive.

    Raises InputError where the timing file cannot be used.
    """
    if options.timing is not None:
        return read_timing(options.timing)
    rng = np.random.default_rng([options.seed, 2])
    span = round(options.duration * NANOSECONDS)
    left = _lidar_stamps(START, span, rng)
    right = _lidar_stamps(START + RIGHT_AFTER_LEFT, span, rng)
    count = span // NANOSECONDS + 1
    jitter = np.clip(rng.normal(size=count), -3.0, 3.0) * FIX_JITTER
    fixes = START + np.arange(count) * NANOSECONDS + 40_000_000 + jitter.astype(np.int64)
    # Last digits keep the sensors' stamps apart: LiDAR 0, GNSS 7, IMU 3.
    return CoreStamps(left, right, fixes // 10 * 10 + 7)


def _lidar_stamps(start: int, span: int, rng: np.random.Generator) -> Stamps:
    """Whole microseconds, as the KAIST LiDARs have them."""
    count = span // LIDAR_PERIOD + 1
    jitter = np.clip(rng.normal(size=count), -3.0, 3.0) * LIDAR_JITTER
    stamps: Stamps = start + np.arange(count) * LIDAR_PERIOD + jitter.astype(np.int64)
    return stamps // 1000 * 1000


def read_timing(path: Path) -> CoreStamps:
    """Read core stamps from a CSV file with the columns ``stamp_ns,sensor``; raises InputError."""
    stamps: dict[str, list[int]] = {sensor: [] for sensor in SENSORS}
    try:
        with path.open(newline='', encoding='utf-8-sig') as file:
            _collect(path, file, stamps)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f'{path}: cannot be read as a timing file ({error})') from error
    if not any(stamps.values()):
        raise InputError(f'{path}: holds no stamp; expected lines such as 1544581126000000000,left')
    arrays: dict[str, Stamps] = {}
    for sensor, values in stamps.items():
        arrays[sensor] = np.array(sorted(values), dtype=np.int64)
        repeated = np.flatnonzero(np.diff(arrays[sensor]) == 0)
        if len(repeated):
            raise InputError(
                f'{path}: {sensor} has the stamp {arrays[sensor][repeated[0]]} twice; remove one'
            )
    core = CoreStamps(arrays['left'], arrays['right'], arrays['gps'])
    if core.duration > MAX_DURATION:
        raise InputError(
            f'{path}: the stamps span {core.duration:.0f} s; the most is {MAX_DURATION:g} s'
        )
    return core


def _collect(path: Path, lines: Iterable[str], stamps: dict[str, list[int]]) -> None:
    reader = csv.reader(lines)
    header = tuple(name.strip() for name in next(reader, ()))
    if header != COLUMNS:
        raise InputError(
            f'{path}: the columns are {",".join(header)!r}, expected {",".join(COLUMNS)!r}'
        )
    for row in reader:
        if not row:
            continue
        where = f'{path}: line {reader.line_num} is {",".join(row)!r}'
        if len(row) != len(COLUMNS) or row[1].strip() not in stamps:
            raise InputError(f'{where}; expected a stamp and one of {", ".join(SENSORS)}')
        text = row[0].strip()
        if not (text.isascii() and text.isdigit() and MIN_STAMP <= int(text) < MAX_STAMP):
            raise InputError(f'{where}; the stamp must be whole nanoseconds since 1970')
        stamps[row[1].strip()].append(int(text))


def imu_stamps(core: CoreStamps, rng: np.random.Generator) -> Stamps:
    """100 Hz with jitter, from a little before the first to a little after the last core stamp."""
    low = core.first - BEFORE - int(rng.integers(IMU_PERIOD))
    count = (core.last + AFTER - low) // IMU_PERIOD + 2
    jitter = np.clip(rng.normal(size=count), -3.0, 3.0) * IMU_JITTER
    stamps: Stamps = low + np.arange(count) * IMU_PERIOD + jitter.astype(np.int64)
    return stamps // 10 * 10 + 3


def truth_stamps(core: CoreStamps) -> Stamps:
    """100 Hz over all sweeps and IMU samples, on whole periods."""
    low = (core.first - 2 * BEFORE) // TRUTH_PERIOD
    high = (core.last + 2 * AFTER) // TRUTH_PERIOD + 1
    return np.arange(low, high + 1, dtype=np.int64) * TRUTH_PERIOD
