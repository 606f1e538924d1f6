"""What the rules on clocks look at: stamps of each sensor, and when its messages were recorded."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.config import Tree
from incremental_mapper.measurements import NANOSECONDS

Stamps = NDArray[np.int64]
NOT_LIDARS = ('imu', 'gnss')
_STRAY = 10.0
"""Seconds; a single stamp further away from the next one is a wrong one."""


@dataclass(frozen=True, slots=True, eq=False)
class SensorClock:
    """Some of the stamps of one sensor, its first and last among them.

    Attributes:
        sensor: name.
        stamps: (N,) nanoseconds, with ``offset`` in them.
        received: (N,) nanoseconds, when each message was recorded or received, by one clock for all
            sensors; None where nobody knows.
        offset: nanoseconds that were added to the stamps.
        chosen: whether the settings name that offset.
        lead: nanoseconds from a stamp to the end of what it is the stamp of, a sweep for example.
    """

    sensor: str
    stamps: Stamps
    received: Stamps | None = None
    offset: int = 0
    chosen: bool = False
    lead: int = 0

    @property
    def is_lidar(self) -> bool:
        """Whether it is neither the IMU nor the receiver."""
        return self.sensor not in NOT_LIDARS

    @property
    def first(self) -> int:
        """First stamp that has others near it."""
        stamps = np.sort(self.stamps)
        return int(stamps[1 if _stray(stamps) else 0])

    @property
    def last(self) -> int:
        """Last stamp that has others near it."""
        stamps = np.sort(self.stamps)
        return int(stamps[-2 if _stray(stamps[::-1]) else -1])


def _stray(stamps: Stamps) -> bool:
    """Whether the first of ordered stamps is far from the next, and the next is not."""
    if len(stamps) < 3:
        return False
    to_next, after = np.abs(np.diff(stamps[:3]))
    return bool(to_next > _STRAY * NANOSECONDS and to_next > 10 * after)


def setting_name(sensor: str) -> str:
    """Name of a sensor's ``time_offset`` as messages and the documentation have it."""
    section = sensor if sensor in NOT_LIDARS else f'lidars.{sensor}'
    return f'{section}.time_offset'


def setting_tree(sensor: str, seconds: float) -> Tree:
    """Settings tree with a sensor's ``time_offset``."""
    inner = {sensor: {'time_offset': seconds}}
    return inner if sensor in NOT_LIDARS else {'lidars': inner}


def setting_line(clock: SensorClock, correction: int) -> tuple[str, Tree]:
    """The line that mends a clock, and the same as settings.

    Args:
        clock: whose stamps are wrong.
        correction: nanoseconds to be added to the stamps as they are.
    """
    # As a double, seconds that count from power-up are exact to half a microsecond.
    seconds = (clock.offset + correction) / NANOSECONDS
    return f'{setting_name(clock.sensor)}: {seconds!r}', setting_tree(clock.sensor, seconds)
