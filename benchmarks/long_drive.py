"""A drive repeated with shifted stamps, each round going on where the one before it ended."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
import pymap3d

from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.bag_writer import BagWriter, bag_settings
from incremental_mapper.datasets.kaist_files import read_recording
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.source import Source, SourceInfo
from incremental_mapper.measurements import NANOSECONDS, Drops, GnssFix, Measurement
from incremental_mapper.settings import write_ros_yaml

PLACE = (0, 1, 4)
"""Columns of latitude, longitude and altitude in ``vrs_gps.csv``."""
PAUSE = 0.15
"""Seconds between two rounds: the surroundings change there, so nothing may be matched across."""


class RepeatedDrive:
    """A source that plays another one ``rounds`` times.

    The fixes of later rounds are moved by the pose in which the round before ended, so that the
    car drives on instead of jumping back. There is no truth for it.
    """

    def __init__(self, source: Source, rounds: int) -> None:
        truth = source.truth()
        if truth is None:
            raise ValueError('a drive is repeated by its true poses, and this one has none')
        self._source, self._rounds = source, rounds
        # Places are counted from the start, where the first fix puts the origin as well.
        matrices = truth.matrices()[[0, -1]]
        matrices[:, :3, 3] -= matrices[0, :3, 3].copy()
        first, last = (_level(gtsam.Pose3(matrix)) for matrix in matrices)
        self.step = last.compose(first.inverse())
        """From the start of a round to that of the next one, in the drive's ENU."""
        info = source.info
        self.span = round((info.duration + PAUSE) * NANOSECONDS)
        """Nanoseconds from round to round."""
        self._info = replace(
            info,
            counts={name: count * rounds for name, count in info.counts.items()},
            duration=info.duration * rounds,
        )

    @property
    def info(self) -> SourceInfo:
        """See Source."""
        return self._info

    @property
    def drops(self) -> Drops:
        """See Source."""
        return Counter(self._source.drops)

    def truth(self) -> None:
        """See Source."""
        return None

    def measurements(self) -> Iterator[Measurement]:
        """See Source."""
        places = MovedPlaces(self.step)
        for number in range(self._rounds):
            for item in self._source.measurements():
                changes: dict[str, Any] = {'stamp': item.stamp + number * self.span}
                if isinstance(item, GnssFix):
                    place = places.moved(item.latitude, item.longitude, item.altitude)
                    changes |= dict(zip(('latitude', 'longitude', 'altitude'), place, strict=True))
                yield replace(item, **changes)
            places.next_round()


class MovedPlaces:
    """Where a fix of the drive lies in a later round, each of which begins a ``step`` further."""

    def __init__(self, step: gtsam.Pose3) -> None:
        self._step, self._T_enu_round = step, gtsam.Pose3()
        self._datum: tuple[float, float, float] | None = None

    def next_round(self) -> None:
        """Another round begins."""
        self._T_enu_round = self._T_enu_round.compose(self._step)

    def moved(self, *place: float) -> tuple[float, ...]:
        """Latitude and longitude in degrees and altitude in metres, moved."""
        latitude, longitude, altitude = place
        self._datum = self._datum or (latitude, longitude, altitude)
        enu = np.array(pymap3d.geodetic2enu(latitude, longitude, altitude, *self._datum))
        there = pymap3d.enu2geodetic(*self._T_enu_round.transformFrom(enu), *self._datum)
        return tuple(float(value) for value in there)


def write_repeated(drive: Path, bag: Path, rounds: int) -> None:
    """Write the bag of a KAIST folder that is driven so many times, each one from the last's end.

    Args:
        drive: The folder, with its truth.
        bag: A folder that is not there.
        rounds: How often.
    """
    repeated = RepeatedDrive(open_source(drive, {}), rounds)
    recording = read_recording(drive)
    places = MovedPlaces(repeated.step)
    with BagWriter(bag, list(recording.streams)) as writer:
        for number in range(rounds):
            for stamp, sensor, index in recording.order({}):
                record = recording.streams[sensor].load(index)
                if sensor == 'gnss':
                    record = record.copy()
                    record[list(PLACE)] = places.moved(*record[list(PLACE)])
                writer.write(sensor, stamp + number * repeated.span, record)
            places.next_round()
    write_ros_yaml(bag / SETTINGS_FILE, bag_settings(recording), f'{rounds} rounds of {drive}')


def _level(pose: gtsam.Pose3) -> gtsam.Pose3:
    """The pose without roll and pitch."""
    return gtsam.Pose3(gtsam.Rot3.Yaw(pose.rotation().yaw()), pose.translation())
