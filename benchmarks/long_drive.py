"""A drive repeated with shifted stamps, each round going on where the one before it ended."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gtsam
import numpy as np
import pymap3d

from incremental_mapper.datasets.source import Source, SourceInfo
from incremental_mapper.measurements import NANOSECONDS, Drops, GnssFix, Measurement

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
        self._step = last.compose(first.inverse())
        info = source.info
        self._span = round((info.duration + PAUSE) * NANOSECONDS)
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
        T_enu_round = gtsam.Pose3()
        datum: tuple[float, float, float] | None = None
        for number in range(self._rounds):
            for item in self._source.measurements():
                changes: dict[str, Any] = {'stamp': item.stamp + number * self._span}
                if isinstance(item, GnssFix):
                    place = (item.latitude, item.longitude, item.altitude)
                    datum = datum or place
                    enu = np.array(pymap3d.geodetic2enu(*place, *datum))
                    moved = T_enu_round.transformFrom(enu)
                    names = ('latitude', 'longitude', 'altitude')
                    shifted = pymap3d.enu2geodetic(*moved, *datum)
                    changes |= {n: float(v) for n, v in zip(names, shifted, strict=True)}
                yield replace(item, **changes)
            T_enu_round = T_enu_round.compose(self._step)


def _level(pose: gtsam.Pose3) -> gtsam.Pose3:
    """The pose without roll and pitch."""
    return gtsam.Pose3(gtsam.Rot3.Yaw(pose.rotation().yaw()), pose.translation())
