"""Gathers measurements into windows by their header stamps (paper, section Methodology).

A window is closed once every live sensor has passed its end, or once the newest stamp is
``lateness`` beyond it. The time of arrival plays no part, so the windows do not depend on how
the sensors' messages were interleaved, as long as each sensor's own come in order and none is
later than that.

Whoever needs windows soon has the buffer predict: a sensor whose next message is not due before a
window's end, or would have come by now, is not waited for. The windows are the same as long as
every sensor keeps to what was usual for it; a message that does not, and comes after its window
was closed, is late.
"""

from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Sequence
from itertools import pairwise
from statistics import median_low

from incremental_mapper.config import WindowSettings
from incremental_mapper.mapping.first_stamps import FIRST, largest, moments, tell_the_time
from incremental_mapper.mapping.pace import Pace
from incremental_mapper.mapping.window import Window
from incremental_mapper.measurements import (
    NANOSECONDS,
    CoreInput,
    Drops,
    ImuSample,
    Measurement,
)

LEAST_LEAP = NANOSECONDS
"""A stamp that far ahead of all others, and more, is not believed at once: windows would be closed
on those that are right."""
LEAP_LATENESS, LEAP_STEPS = 2, 4
"""So many times ``lateness``, or what the clock usually goes on by, are no leap either: sensors may
come in that late, and keyframes of real recordings are seconds apart."""
STEPS = 9
"""Steps of the clock that tell what is usual."""
LEAP_WITNESSES = 8
"""So many measurements in a row beyond a leap prove that the clock did move."""
AGREEMENT = 10 * NANOSECONDS
"""Witnesses of one leap, at least, are no further apart from each other than this, or than a leap;
stray stamps are anywhere."""
MOST_SUSPECTS = 1000
"""Measurements beyond a leap that wait for proof."""
MAX_BEHIND = 10 * NANOSECONDS
"""A stamp that far behind the first ones does not begin the windows, unless as many others say that
it is the first ones that are far ahead."""
PATIENCE = 3 * NANOSECONDS
"""A buffer that predicts waits so long for sensors that have never sent anything."""


class WindowBuffer:
    """Sorts incoming measurements and hands out closed windows in order.

    ``sensors`` are those to wait for from the start; others are waited for once they are seen.
    With ``predict`` none is waited for beyond what is usual for it. ``better`` tells whether a
    measurement takes the place of one with its sensor and stamp. ``begin`` is told of each one that
    goes on from its sensor's newest and is not ahead of the others: it will be handed out as the
    next of its sensor. ``sample`` is told of each IMU sample that will be handed out. ``restart``
    is called before the first window where that will not be: their stamps proved to be strays.
    """

    def __init__(
        self,
        settings: WindowSettings,
        sensors: Iterable[str] = (),
        predict: bool = False,
        better: Callable[[CoreInput, CoreInput], bool] = lambda new, held: False,
        begin: Callable[[CoreInput], None] | None = None,
        sample: Callable[[ImuSample], None] = lambda sample: None,
        restart: Callable[[], None] = lambda: None,
    ) -> None:
        self._awaited = set(sensors)
        self._predict = predict
        self._paces: dict[str, Pace] = {}
        self._better, self._begin, self._sample = better, begin, sample
        self._restart = restart
        self._begun: dict[str, int] = {}  # newest stamp by sensor
        self._unbegun: set[tuple[int, str]] = set()  # core measurements that wait
        self._duration = round(settings.duration * NANOSECONDS)
        self._lateness = round(settings.lateness * NANOSECONDS)
        self._core: dict[tuple[int, str], CoreInput] = {}
        self._imu: dict[tuple[int, str], ImuSample] = {}
        self._newest: dict[str, int] = {}
        self._steps: deque[int] = deque(maxlen=STEPS)
        self._suspects: list[Measurement] = []  # beyond a leap, in the order of arrival
        self._in_a_row = 0  # of them, since a stamp was in time
        self._behind: list[Measurement] = []  # far behind all others, before the grid starts
        self._behind_in_a_row = 0
        self._first: list[Measurement] | None = []  # None once the clock is known
        self._start: int | None = None
        self._first_start = 0  # of the whole grid
        self._closed_core = -1  # newest core stamp that was handed out
        self._closed_imu = -1
        self.drops: Drops = Counter()
        self.late = 0  # core measurements that moved to a later window

    def __len__(self) -> int:
        return len(self._core) + len(self._imu)

    def push(self, measurement: Measurement) -> None:
        """Take in one measurement; what cannot be used is counted in ``drops``."""
        if self._first is not None:
            self._first.append(measurement)
            if tell_the_time(self._first):
                self._set_clock()
            return
        stamp = measurement.stamp
        newest = max(self._newest.values(), default=stamp)
        # What a leap is costs more to know than that this is none.
        if stamp - newest > LEAST_LEAP and stamp - newest > self._leap(self._steps):
            self._suspect(measurement)
            return
        self._in_a_row = 0
        if stamp > newest and self._suspects:
            self._refute(self._newest.keys())
        if self._start is None and newest - stamp > max(MAX_BEHIND, self._lateness):
            # Nothing else would be late before the grid starts: it would start there.
            self._contradict(measurement)
            return
        self._behind_in_a_row = 0
        self._insert(measurement)

    @property
    def newest(self) -> int | None:
        """Newest stamp (ns) that is believed; None before the first one."""
        return max(self._newest.values(), default=None)

    def pop_ready(self) -> list[Window]:
        """Windows that no measurement in time can change any more, oldest first."""
        windows: list[Window] = []
        while True:
            window = self._next(self._watermark())
            if window is None:
                return windows
            windows.append(window)

    def flush(self) -> list[Window]:
        """All that is left, as closed windows."""
        self._set_clock()
        if self._in_a_row > 1:  # nothing will come to refute them
            self._believe([item for item in self._suspects if self._agree(item)])
        self._refute({item.sensor for item in self._suspects})
        self._refute_behind()
        windows: list[Window] = []
        while True:
            window = self._next(None)
            if window is None:
                break
            windows.append(window)
        if self._imu:
            stamps = [stamp for stamp, _ in self._imu]
            start = min(stamps) if self._start is None else self._start
            windows.append(self._take(start, max(max(stamps), start) + 1))
        return windows

    def _set_clock(self) -> None:
        """Tell by the first measurements what time it is: one alone may be far off it."""
        first, self._first = self._first, None
        if not first:
            return
        stamps = moments(first)
        now = largest(stamps)
        if len(now) >= FIRST:
            stamps = now
        middle = stamps[(len(stamps) - 1) // 2]
        most = self._leap([after - before for before, after in pairwise(stamps)])
        least = -max(MAX_BEHIND, self._lateness)
        beyond = [item for item in first if item.stamp - middle > most]
        behind = [item for item in first if item.stamp - middle < least]
        for item in first:
            if item not in beyond and item not in behind:
                self._insert(item)
        for item in beyond:
            self._suspect(item)
        for item in behind:
            self._hold_behind(item)
        self._in_a_row = self._behind_in_a_row = 0

    def _leap(self, steps: Sequence[int]) -> int:
        """Nanoseconds by which a stamp may be ahead of all others, by the usual steps of time."""
        usual = median_low(steps) if steps else 0
        return max(LEAST_LEAP, LEAP_LATENESS * self._lateness, LEAP_STEPS * usual)

    def _suspect(self, measurement: Measurement) -> None:
        """Hold what is beyond a leap, until enough others prove it or time goes on before it."""
        sensor, stamp = measurement.sensor, measurement.stamp
        if any(item.stamp == stamp and item.sensor == sensor for item in self._suspects):
            self.drops[sensor, 'duplicate_stamp'] += 1  # proves no more than the first one
            return
        if self._suspects and not self._agree(measurement):
            self._in_a_row = 0
        self._suspects.append(measurement)
        self._in_a_row += 1
        alike = [item for item in self._suspects if self._agree(item)]
        own = [item for item in alike if item.sensor == measurement.sensor]
        if self._in_a_row >= LEAP_WITNESSES:
            self._believe(alike)
            self._refute({item.sensor for item in self._suspects})
        elif measurement.sensor not in self._newest and len(own) >= LEAP_WITNESSES:
            # It has never been in time: its clock is another, and no stray stamps.
            for item in own:
                self._insert(item)
            self._suspects = [item for item in self._suspects if item.sensor not in self._newest]
        elif len(self._suspects) > MOST_SUSPECTS:
            self.drops[self._suspects.pop(0).sensor, 'stamp_leap'] += 1

    def _contradict(self, measurement: Measurement) -> None:
        """Hold what is far behind; where it is more than what is in time, that is given up."""
        if not self._hold_behind(measurement):
            return
        alike = [item for item in self._behind if self._near(item, measurement)]
        in_time = len(self)
        if self._behind_in_a_row >= LEAP_WITNESSES or len(alike) > max(in_time, LEAP_WITNESSES):
            self._give_up(alike)

    def _hold_behind(self, measurement: Measurement) -> bool:
        """Hold what is far behind; returns whether it is another one than those that are held."""
        sensor, stamp = measurement.sensor, measurement.stamp
        if any(item.stamp == stamp and item.sensor == sensor for item in self._behind):
            self.drops[sensor, 'duplicate_stamp'] += 1
            return False
        if self._behind and not self._near(self._behind[-1], measurement):
            self._behind_in_a_row = 0
        self._behind.append(measurement)
        self._behind_in_a_row += 1
        if len(self._behind) > MOST_SUSPECTS:
            self.drops[self._behind.pop(0).sensor, 'stamp_leap'] += 1
        return True

    def _give_up(self, witnesses: Sequence[Measurement]) -> None:
        """Begin anew with ``witnesses``; what was in time by now was ahead of it."""
        for _, sensor in [*self._core, *self._imu]:
            self.drops[sensor, 'stamp_leap'] += 1
        self._core, self._imu, self._newest = {}, {}, {}
        self._paces, self._begun, self._unbegun = {}, {}, set()
        self._steps.clear()
        self._restart()
        for witness in witnesses:
            self._insert(witness)
        self._behind = [item for item in self._behind if item not in witnesses]
        self._in_a_row = self._behind_in_a_row = 0

    def _refute_behind(self) -> None:
        """Leave out what is far behind."""
        for item in self._behind:
            self.drops[item.sensor, 'stamp_leap'] += 1
        self._behind = []

    def _agree(self, item: Measurement) -> bool:
        """Whether a measurement may be of the same leap as the last suspect."""
        return self._near(item, self._suspects[-1])

    def _near(self, one: Measurement, other: Measurement) -> bool:
        """Whether two measurements may be of one leap."""
        return abs(one.stamp - other.stamp) <= max(AGREEMENT, self._leap(self._steps))

    def _believe(self, witnesses: Sequence[Measurement]) -> None:
        """All clocks moved on: none is waited for in the time that was leapt over."""
        first = min(witness.stamp for witness in witnesses)
        self._newest = dict.fromkeys(self._newest, first)
        for pace in self._paces.values():
            pace.move(first)
        for witness in witnesses:
            self._insert(witness)
        self._suspects = [item for item in self._suspects if item not in witnesses]
        self._in_a_row = 0

    def _refute(self, sensors: Collection[str]) -> None:
        """Leave out the suspects of some sensors: time goes on without them."""
        kept = []
        for suspect in self._suspects:
            if suspect.sensor in sensors:
                self.drops[suspect.sensor, 'stamp_leap'] += 1
            else:
                kept.append(suspect)
        self._suspects = kept

    def _insert(self, measurement: Measurement) -> None:
        stamp, sensor = measurement.stamp, measurement.sensor
        key = (stamp, sensor)
        if isinstance(measurement, ImuSample):
            if key in self._imu:
                self.drops[sensor, 'duplicate_stamp'] += 1
            elif stamp <= self._closed_imu:
                self.drops[sensor, 'late'] += 1
            else:
                self._imu[key] = measurement
                self._sample(measurement)
        elif key in self._core:
            self.drops[sensor, 'duplicate_stamp'] += 1
            if self._better(measurement, self._core[key]):
                self._core[key] = measurement
        elif stamp <= max(self._closed_core, self._begun.get(sensor, -1)):
            self.drops[sensor, 'late'] += 1
        else:
            if self._start is not None and stamp < self._start:
                self.late += 1
            self._core[key] = measurement
            if self._begin is not None and self._comes_next(stamp, sensor):
                self._begun[sensor] = stamp
                self._begin(measurement)
            else:
                self._unbegun.add(key)
        if self._predict:
            self._learn(stamp, sensor)
        newest = max(self._newest.values(), default=stamp)
        if stamp > newest:
            self._steps.append(stamp - newest)
        self._newest[sensor] = max(stamp, self._newest.get(sensor, stamp))

    def _comes_next(self, stamp: int, sensor: str) -> bool:
        """Whether a message is the next of its sensor; a stray one ahead of all others is not."""
        if any(name == sensor for _, name in self._unbegun):
            return False  # it is handed out first
        others = (newest for name, newest in self._newest.items() if name != sensor)
        last = self._newest.get(sensor, -1)
        usual = max(others, default=last if last >= 0 else stamp)
        return last < stamp <= usual + self._duration

    def _learn(self, stamp: int, sensor: str) -> None:
        """Keep what is usual for a sensor, before its stamp is the newest."""
        pace = self._paces.get(sensor)
        if pace is None:
            pace = self._paces[sensor] = Pace(stamp)
        pace.take(stamp, max(self._newest.values(), default=stamp), self._lateness)

    def _watermark(self) -> int:
        """All windows that end at or before this stamp are closed."""
        newest = max(self._newest.values(), default=0)
        slowest = min(self._newest.values(), default=0)
        patient = newest - self._lateness
        # Where the grid starts is decided once, and all windows depend on it: by then all sensors
        # have told of themselves, and each one's messages come in order.
        if self._predict and (self._start is not None or not self._awaited - self._newest.keys()):
            return self._predicted(newest, patient)
        return patient if self._awaited - self._newest.keys() else max(slowest, patient)

    def _predicted(self, newest: int, patient: int) -> int:
        """The same by what is usual for each sensor."""
        silent = self._awaited - self._newest.keys()
        if silent and newest - self._first_start < PATIENCE:
            return patient
        live = [p for p in self._paces.values() if not p.silent(newest, self._lateness)]
        grain = min((p.longest for p in live if p.longest is not None), default=0)
        return min((p.complete_until(newest, grain, self._lateness) for p in live), default=newest)

    def _next(self, watermark: int | None) -> Window | None:
        if not self._core:
            return None
        oldest, _ = min(self._core)
        if self._start is None:
            # The grid starts at the first core stamp, once nothing older can come.
            if watermark is not None and watermark < oldest + self._duration:
                return None
            self._start = self._first_start = oldest
            self._refute_behind()
        # Empty windows are passed over, but only once nothing can come to fill them.
        start = self._start + max(oldest - self._start, 0) // self._duration * self._duration
        end = start + self._duration
        if watermark is not None and watermark < end:
            return None
        return self._take(start, end)

    def _take(self, start: int, end: int) -> Window:
        core = sorted(key for key in self._core if key[0] < end)
        imu = sorted(key for key in self._imu if key[0] < end)
        self._start = end
        self._unbegun.difference_update(core)
        if core:
            self._closed_core = core[-1][0]
        if imu:
            self._closed_imu = imu[-1][0]
        return Window(
            start=start,
            end=end,
            core=tuple(self._core.pop(key) for key in core),
            imu=tuple(self._imu.pop(key) for key in imu),
        )
