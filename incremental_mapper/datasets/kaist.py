"""KAIST Complex Urban folders as a source of measurements."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.constant_range import without_constant_ranges
from incremental_mapper.checks.sensor_clocks import SensorClock
from incremental_mapper.config import Tree
from incremental_mapper.datasets.clock_look import check_clocks
from incremental_mapper.datasets.kaist_files import (
    LIDARS,
    Recording,
    fix_parts,
    imu_parts,
    is_kaist_folder,
    point_times,
    read_recording,
    read_scan_folder,
)
from incremental_mapper.datasets.remarks import Remarks
from incremental_mapper.datasets.sampling import (
    SampleMaker,
    SamplePlan,
    SensorKind,
    SensorSample,
    clouds_of_each,
    spans,
    spread,
)
from incremental_mapper.datasets.sensor_settings import (
    extrinsics_of,
    listed_lidars,
)
from incremental_mapper.datasets.source import SourceInfo
from incremental_mapper.datasets.truth import find_truth, truth_file
from incremental_mapper.errors import InputError, MeasurementError
from incremental_mapper.measurements import (
    NANOSECONDS,
    Drops,
    LidarScan,
    Measurement,
    make_fix,
    make_imu,
    make_scan,
)
from incremental_mapper.settings import merge
from incremental_mapper.trajectory import Trajectory

_KINDS = {'imu': SensorKind.IMU, 'gnss': SensorKind.GNSS}


class KaistSource:
    """A KAIST sequence, or a bare folder of ``<stamp>.bin`` scans (one LiDAR, ``left``)."""

    def __init__(self, path: Path, settings: Mapping[str, Any] | None = None) -> None:
        """Open the folder; ``settings`` is the user's tree (time offsets, names of the LiDARs).

        Raises InputError where the folder cannot be used, ConfigError for bad settings.
        """
        tree = settings or {}
        self._given = tree
        bare = not is_kaist_folder(path) and any(path.glob('*.bin'))
        self._recording = read_scan_folder(path) if bare else read_recording(path)
        self._calibration = 'nowhere: identity' if bare else 'calibration/'
        used = _choose(self._recording, listed_lidars(tree))
        own = extrinsic_settings(self._recording, used)
        clocks = check_clocks(self._clocks, merge(own, tree), used)
        self._offsets, self._apart = clocks.offsets, clocks.apart
        self._late_drops: Drops = Counter()
        self._remarks = Remarks()
        first, last = self._recording.span()
        self._info = SourceInfo(
            path=path,
            kind='folder of scans' if bare else 'KAIST folder',
            counts={name: len(self._recording.streams[name].stamps) for name in used},
            duration=(last - first) / NANOSECONDS,
            settings=merge(own, clocks.settings),
            notes=self._recording.notes,
            findings=clocks.findings,
        )

    @property
    def info(self) -> SourceInfo:
        """Facts about the folder, with what the last run of ``measurements`` remarked."""
        findings = (*self._info.findings, *self._remarks.findings())
        return replace(self._info, findings=findings)

    @property
    def drops(self) -> Drops:
        """Unreadable lines, and the records that the last run of ``measurements`` could not use."""
        return self._recording.drops + self._late_drops

    def measurements(self) -> Iterator[Measurement]:
        """All usable measurements by stamp; clouds are read when their turn comes."""
        self._late_drops = Counter()
        self._remarks = Remarks()
        for stamp, sensor, index in self._recording.order(self._offsets):
            if sensor not in self._offsets:
                continue
            if sensor in self._apart:
                self._late_drops[sensor, 'no_common_time'] += 1
                continue
            try:
                record = self._recording.streams[sensor].load(index)
                measurement = _measurement(stamp, sensor, record)
            except MeasurementError as error:
                self._late_drops[sensor, error.reason] += 1
                continue
            self._remarks.take(measurement)
            yield measurement

    def sample(self, plan: SamplePlan) -> tuple[SensorSample, ...]:
        """Read a sample of every sensor; of other clouds only the names are known."""
        stamps = {
            name: self._recording.streams[name].stamps + offset
            for name, offset in self._offsets.items()
        }
        ends = [(int(some[0]), int(some[-1])) for some in stamps.values() if len(some)]
        begin, end = min(first for first, _ in ends), max(last for _, last in ends)
        bounds = spans(begin, end, plan, stamps.get('gnss'))
        return tuple(self._sample(plan, name, some, bounds) for name, some in stamps.items())

    def _sample(
        self,
        plan: SamplePlan,
        sensor: str,
        stamps: NDArray[np.int64],
        bounds: list[tuple[int, int]],
    ) -> SensorSample:
        stream = self._recording.streams[sensor]
        lidars = [name for name in self._offsets if name in LIDARS]
        given = extrinsics_of(self._given, sensor, lidars) is not None
        maker = SampleMaker(
            clouds_of_each(bounds, plan),
            sensor=sensor,
            kind=_KINDS.get(sensor, SensorKind.LIDAR),
            count=len(stamps),
            origin='the settings' if given else self._calibration,
            recorded=stamps,
        )
        wanted = [
            (block, index)
            for block, (start, stop) in enumerate(bounds)
            for index in range(*np.searchsorted(stamps, [start, stop]))
        ]
        if sensor == 'gnss' and plan.fixes:
            every = spread(np.arange(len(stamps)), plan.fixes)
            seen = {index for _, index in wanted}
            wanted += [(len(bounds) + n, i) for n, i in enumerate(every) if i not in seen]
        for block, index in wanted:
            stamp = int(stamps[index])

            def make(stamp: int = stamp, index: int = index) -> Measurement:
                return _measurement(stamp, sensor, stream.load(index))

            maker.add(block, stamp, stamp, make)
        return maker.sample()

    def scans(
        self, sensor: str, bounds: Sequence[tuple[int, int]]
    ) -> Iterator[tuple[int, LidarScan]]:
        """See ``Sampled``; the stamps stand for the times of recording."""
        stream = self._recording.streams[sensor]
        stamps = stream.stamps + self._offsets[sensor]
        for number, span in enumerate(bounds):
            for index in range(*np.searchsorted(stamps, span)):
                try:
                    scan = _measurement(int(stamps[index]), sensor, stream.load(index))
                except MeasurementError:
                    continue
                assert isinstance(scan, LidarScan)
                yield number, scan

    def truth(self) -> Trajectory | None:
        """The trajectory of ``global_pose.csv``, in the folder or in its ``sensor_data``."""
        return find_truth(self._truth_folders())

    def truth_place(self) -> str:
        """See ``Sampled``."""
        path = truth_file(self._truth_folders())
        return '' if path is None else path.name

    def _truth_folders(self) -> list[Path]:
        return [self._info.path, self._info.path / 'sensor_data']

    def _clocks(self, offsets: Mapping[str, int], chosen: Sequence[str]) -> list[SensorClock]:
        """Stamps of the sensors in use; nothing tells when the records were made."""
        return [
            SensorClock(
                name,
                self._recording.streams[name].stamps + offset,
                None,
                offset,
                name in chosen,
            )
            for name, offset in offsets.items()
        ]


def extrinsic_settings(recording: Recording, used: list[str]) -> Tree:
    """Make the settings that a recording brings itself.

    Args:
        recording: where the poses are from.
        used: names of the sensors that are wanted.

    Returns:
        A settings tree with T_base_sensor of each, row-major 3x4, and the names of the LiDARs.
    """
    poses = {
        name: {'T_base_sensor': recording.extrinsics[name][:3].ravel().tolist()} for name in used
    }
    lidars: Tree = {'names': [name for name in used if name in LIDARS]}
    lidars |= {name: poses[name] for name in lidars['names']}
    return {'lidars': lidars} | {name: pose for name, pose in poses.items() if name not in LIDARS}


def _choose(recording: Recording, listed: list[str] | None) -> list[str]:
    """The sensors to use; a listed LiDAR without scans is left out, the notes tell of it."""
    if listed is None:
        return list(recording.streams)
    unknown = [name for name in listed if name not in LIDARS]
    if unknown:
        raise InputError(
            f'{recording.path}: the settings list LiDAR {unknown[0]!r}; the folder has '
            f'{" and ".join(recording.lidars)}'
        )
    used = [name for name in recording.streams if name in listed or name not in LIDARS]
    if not any(name in LIDARS for name in used):
        raise InputError(
            f'{recording.path}: has no scans of the listed LiDARs {listed}, only of '
            f'{" and ".join(recording.lidars)}'
        )
    return used


def _measurement(stamp: int, sensor: str, record: NDArray[np.floating]) -> Measurement:
    if sensor in LIDARS:
        points, remarks = without_constant_ranges(record[:, :3])
        scan = make_scan(stamp, sensor, points, point_times(record), intensities=record[:, 3])
        return replace(scan, remarks=remarks) if remarks else scan
    if sensor == 'imu':
        return make_imu(stamp, sensor, *imu_parts(record))
    return make_fix(stamp, sensor, *fix_parts(record))
