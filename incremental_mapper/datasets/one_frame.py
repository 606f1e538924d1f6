"""Tells the messages of two receivers or IMUs on one topic apart by their frame_ids."""

from collections import Counter, defaultdict

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.live_inputs import foreign_messages
from incremental_mapper.measurements import NANOSECONDS, Drops

FOREIGN = 'foreign_frame'
"""Why a message is left out that comes between those of another frame_id."""
RENAMED = 5 * NANOSECONDS
"""Nanoseconds without a message of a sensor's own frame_id after which another one is its new
name: a receiver of 1 Hz may miss a few."""
OUTNUMBERS = 3
"""Or so many times as many messages of another one: the first message was a stray one."""

MOST = 20
"""frame_ids of one topic that are told apart: a driver that counts in them has ever new ones."""
OTHERS = '(others)'


class FrameNames:
    """Names of the frame_ids of each topic: their own, as long as they are not too many."""

    def __init__(self) -> None:
        self._known: defaultdict[str, set[str]] = defaultdict(set)

    def name(self, topic: str, frame: str) -> str:
        """The frame_id, or OTHERS where the topic has had MOST without it.

        Args:
            topic: Of which topic, or sensor, the message is.
            frame: Its frame_id.
        """
        known = self._known[topic]
        if frame not in known and len(known) >= MOST:
            return OTHERS
        known.add(frame)
        return frame


class OneFrame:
    """Lets one frame_id a sensor pass: the first one, as long as it goes on and is no stray one.

    Two antennas, or two IMUs, on one topic would be taken for one that jumps to and fro. LiDARs on
    one topic are each mapped, and are told apart elsewhere. ``drops`` counts what does not pass.
    """

    def __init__(self) -> None:
        self.drops: Drops = Counter()
        self._names = FrameNames()
        self._own: dict[str, str] = {}
        self._newest: dict[str, int] = {}  # stamp of the own frame_id
        self._foreign: Counter[tuple[str, str]] = Counter()
        self._count: Counter[tuple[str, str]] = Counter()

    def take(self, sensor: str, frame: str, stamp: int) -> bool:
        """Tell whether a message is the sensor's.

        Args:
            sensor: On whose topic it came.
            frame: Its frame_id.
            stamp: Its header stamp, ns.
        """
        frame = self._names.name(sensor, frame)
        own = self._own.setdefault(sensor, frame)
        self._count[sensor, frame] += 1
        if frame != own:
            few = self._count[sensor, frame] < OUTNUMBERS * self._count[sensor, own]
            if few and stamp - self._newest[sensor] <= RENAMED:
                self._foreign[sensor, frame] += 1
                self.drops[sensor, FOREIGN] += 1
                return False
            self._own[sensor] = frame
        self._newest[sensor] = max(stamp, self._newest.get(sensor, stamp))
        return True

    def findings(self) -> tuple[Finding, ...]:
        """What was left out."""
        return tuple(
            foreign_messages(sensor, self._own[sensor], frame, count)
            for (sensor, frame), count in self._foreign.items()
        )
