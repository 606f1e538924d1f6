"""Tells a bag's messages with stray stamps from those that came late."""

from collections.abc import Mapping

from incremental_mapper.measurements import NANOSECONDS

EARLY, LATE = -NANOSECONDS, 5 * NANOSECONDS
"""A lag that differs by more from what is usual for its sensor is no latency, and no backlog."""
BACKLOG = NANOSECONDS
"""Lags that are so much above what is usual are of a backlog: in the order of stamps."""


class StrayStamps:
    """Holds the stamps of messages against the times at which they were recorded."""

    def __init__(self, usual: Mapping[str, int]) -> None:
        """``usual`` are nanoseconds from stamp to record time, of the sensors where it is known."""
        self._usual = usual
        self._newest: dict[str, int] = {}  # stamps, by sensor

    def is_stray(self, sensor: str, stamp: int, logged: int) -> bool:
        """Tell whether a stamp is another time's; asked in the order of recording.

        Args:
            sensor: Whose message it is.
            stamp: Its header stamp, ns.
            logged: When it was recorded, ns.
        """
        if sensor not in self._usual:
            return False
        behind = logged - stamp - self._usual[sensor]
        if not EARLY <= behind <= LATE:
            return True
        newest = self._newest.get(sensor)
        # Before the first message with the usual lag nobody knows of a backlog: one would cost its
        # messages, a stray that is believed begins the map seconds early.
        if behind > BACKLOG and (newest is None or stamp <= newest):
            return True
        self._newest[sensor] = stamp if newest is None else max(stamp, newest)
        return False
