"""Stamps that jump: a looped bag, a clock that was set, of all sensors or of one, stray stamps.

A jump is one only if all sensors that are alive share it. What does not agree with its sensor's
stamps so far is held until it is decided, so that nothing of a jump is lost:

stray
    its sensor goes on as before: the message is left out.
one sensor's clock
    it goes on from there while another goes on as before: that is told, what came meanwhile is left
    out and counted, and from then on its stamps are moved back by the step, until they agree with
    the others' again as they did before. Where the size of the step is not certain, or the clock is
    set again and again, the sensor is left out until then.
all sensors' time
    all others do the same or are silent: forwards it is a pause, and all that was held is mapped;
    beyond a day it is a clock that was set, as that of a computer which has started without the
    time, and a new map begins; backwards the policy decides.
"""

from collections import Counter, deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise, takewhile
from statistics import median_low

from incremental_mapper.checks.gaps import LONGEST_PAUSE
from incremental_mapper.config import TimeJumpPolicy, TimeJumpSettings
from incremental_mapper.measurements import NANOSECONDS, Drops, Measurement
from incremental_mapper.ros.clock_steps import MOST_REALIGNED, Beyond, ClockStep, step_size

WITNESSES = 5
"""So many messages beyond a jump prove it, where all sensors that are alive have one of them."""
SLOWER = 3.0
"""What goes on beyond a jump does so at steps of its sensor's usual ones, up to so many times as
long; stray stamps, however many, do not."""
WITNESSES_ANEW = 15
"""Without that so many prove it, at steps of their own that are alike: drivers that came back after
a pause at another rate."""
OWN_AGREEMENT, AGREEMENT = 60 * NANOSECONDS, 10 * NANOSECONDS
"""Messages that are held for one jump are no further apart than this, of one sensor and of two;
stray stamps are anywhere."""
_LONGEST_PAUSE = round(LONGEST_PAUSE * NANOSECONDS)
FAR_PROOF = NANOSECONDS
"""By so much the stamps of those that prove such a leap go on: stray ones of a clock that was never
set are all of one second."""
ALONE = 2
"""Another sensor that went on with so many messages did not take part in a jump."""
HOLD = 4 * NANOSECONDS
"""Nanoseconds of a sensor's messages that are held while it is not decided what they are."""
SHORTEST_PATIENCE, LONGEST_PATIENCE = NANOSECONDS // 2, 3 * NANOSECONDS
"""A sensor is waited for to tell whether it jumped too; its periods count in between."""
_PERIODS = 2.5
_USUAL = 16
"""Messages that tell what is usual for a sensor."""
_SECONDS_OF_LAGS = 128
"""Messages by which a step is measured: a second or more of every sensor's."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Measurements to map, oldest arrival first; with ``jumped`` they belong to a new map."""

    measurements: tuple[Measurement, ...]
    jumped: bool = False


@dataclass(frozen=True, slots=True)
class _Held:
    """A measurement that is not decided on, and the number of its arrival.

    ``behind`` is how far the others were beyond it (ns), ``number`` how many of its sensor's came
    since the last that agreed.
    """

    measurement: Measurement
    order: int
    behind: int
    number: int

    @property
    def stamp(self) -> int:
        return self.measurement.stamp


def _usual() -> deque[int]:
    return deque(maxlen=_USUAL)


def _longer() -> deque[int]:
    return deque(maxlen=_SECONDS_OF_LAGS)


@dataclass(slots=True)
class _Sensor:
    """What is known of one sensor; stamps in ns."""

    newest: int
    heard: int  # number of the arrival with which it last went on
    begun: int  # number of its first arrival
    went_on: int = 0  # messages with which it did
    lags: deque[int] = field(default_factory=_usual)  # how far it is behind the others
    steps: deque[int] = field(default_factory=_usual)
    apart: deque[int] = field(default_factory=_usual)  # the same of all that came of it
    held: list[_Held] = field(default_factory=list)
    away: int = 0  # messages since it last agreed
    away_since: dict[str, int] = field(default_factory=dict)  # how far others had gone on by then
    alone: bool = False
    all_lags: deque[int] = field(default_factory=_longer)
    shift: int = 0  # what its clock stepped by and its stamps are moved back by
    realigned: int = 0  # times

    @property
    def step(self) -> int | None:
        return median_low(self.steps) if self.steps else None

    @property
    def lag(self) -> int:
        return median_low(self.lags) if self.lags else 0

    @property
    def patience(self) -> int:
        """Silence (ns) after which nobody waits for its vote."""
        step = self.step
        if step is None:
            return LONGEST_PATIENCE
        return min(max(round(_PERIODS * step), SHORTEST_PATIENCE), LONGEST_PATIENCE)

    def went_on_beyond(self, step: int | None) -> int:
        """How many messages of those held go on at steps like ``step`` (ns) up to the newest."""
        if step is None:
            return 0
        steps = [after.stamp - before.stamp for before, after in pairwise(self.held)]
        gone = sum(1 for _ in takewhile(lambda one: 0 < one <= SLOWER * step, reversed(steps)))
        return gone + 1 if gone else 0

    def held_step(self) -> int | None:
        """Usual step (ns) of what is held."""
        steps = [after.stamp - before.stamp for before, after in pairwise(self.held)]
        return median_low(steps) if steps else None


class JumpFilter:
    """Decides by the state of each sensor what stamps that do not go on as before are."""

    def __init__(self, settings: TimeJumpSettings) -> None:
        self._threshold = round(settings.threshold * NANOSECONDS)
        self._policy = settings.policy
        self._sensors: dict[str, _Sensor] = {}
        self._order = 0
        self._clock_jumped = False
        self._clock_refuted: int | None = None  # stamp from which on no sensor followed it
        self.jumps = 0
        self.drops: Drops = Counter()
        self.steps: Mapping[str, ClockStep] = {}
        """Of the sensors whose clock stepped alone."""

    def restart(self) -> None:
        """Forget all stamps; the counts stay."""
        self._sensors, self.steps = {}, {}

    def moved(self, measurement: Measurement) -> Measurement:
        """A measurement with the stamp that it is mapped with by now; any thread may ask.

        Args:
            measurement: Of a sensor whose clock may have stepped.
        """
        sensor = self._sensors.get(measurement.sensor)
        shift = 0 if sensor is None else sensor.shift
        return replace(measurement, stamp=measurement.stamp - shift) if shift else measurement

    def forget(self, sensors: Collection[str]) -> None:
        """Take some sensors for new ones: their stamps are others from now on.

        Args:
            sensors: Their names.
        """
        for name in sensors:
            sensor = self._sensors.pop(name, None)
            if sensor is not None:
                self._drop(name, sensor, len(sensor.held))
        self.steps = {name: step for name, step in self.steps.items() if name not in sensors}

    def clock_jumped(self) -> None:
        """The clock itself went back: one measurement of each sensor suffices as witness.

        Not for ever: a clock that was set while the sensors kept theirs says nothing of them.
        """
        self._clock_refuted, self._clock_jumped = None, True

    def check(self, measurement: Measurement) -> Passed:
        """What to map now that ``measurement`` came."""
        self._order += 1
        name = measurement.sensor
        others = self._newest_of_others(name)
        sensor = self._sensors.get(name)
        if sensor is not None and sensor.shift:
            measurement = self._realigned(sensor, measurement, others)
        stamp = measurement.stamp
        if sensor is None:
            sensor = self._sensors[name] = _Sensor(stamp, self._order, self._order)
            if others is None or stamp <= others + self._threshold:
                return self._go_on(sensor, measurement, others)
            # Nobody knows what is usual for it: where it goes back to is as good.
            sensor.newest = others
        if others is not None:
            sensor.apart.append(others - stamp)
        if self._agrees(sensor, stamp, others):
            return self._go_on(sensor, measurement, others)
        return self._hold(sensor, measurement, others)

    def settle(self) -> tuple[Measurement, ...]:
        """Decide on all that is held, as nothing more may come; returns what to map."""
        passed: list[_Held] = []
        for name, sensor in self._sensors.items():
            ahead = bool(sensor.held) and sensor.held[0].stamp > sensor.newest
            with_it = [s for s in self._sensors.values() if s.held]
            total = sum(len(item.held) for item in with_it)
            refuted = any(
                other.heard > sensor.held[0].order
                for other in self._sensors.values()
                if sensor.held and other is not sensor and not other.away
            )
            if ahead and total > 1 and not refuted:
                passed += sensor.held
                sensor.newest = sensor.held[-1].stamp
                sensor.away, sensor.alone = 0, False
            else:
                self._drop(name, sensor, len(sensor.held))
            sensor.held = []
        return tuple(item.measurement for item in sorted(passed, key=lambda item: item.order))

    def _newest_of_others(self, name: str) -> int | None:
        """Newest stamp (ns) that all but one sensor have reached; None where there is no other."""
        return max(
            (s.newest for other, s in self._sensors.items() if other != name and s.went_on),
            default=None,
        )

    def _agrees(self, sensor: _Sensor, stamp: int, others: int | None) -> bool:
        """Whether a stamp goes on from its sensor's own, or stands to the others' as usual."""
        slack = self._slack()
        if others is None:
            # Who is alone and new has nothing that it could be held against.
            return -self._threshold <= stamp - sensor.newest <= slack or sensor.went_on < 3
        if not sensor.away and -self._threshold <= stamp - sensor.newest <= slack:
            return True
        seldom = 0.0 if sensor.away or sensor.step is None else SLOWER * sensor.step
        if 0 < stamp - sensor.newest <= seldom and stamp - others <= self._threshold:
            return True  # at its own pace, and held up on the way, or no longer
        if abs(others - stamp - sensor.lag) <= slack:
            return True
        if abs(others - stamp) > self._threshold:
            return False
        # One stamp alone, or two, do not tell what is usual; nor did strays at the beginning,
        # where most of what comes now stands beside the others.
        settled = len(sensor.apart) == _USUAL and abs(median_low(sensor.apart)) <= self._threshold
        return sensor.went_on < 3 or settled

    def _slack(self) -> int:
        """Nanoseconds by which stamps may go on at once, or differ from what is usual."""
        steps = [step for item in self._sensors.values() if (step := item.step) is not None]
        return max(self._threshold, 3 * min(steps, default=0))

    def _go_on(self, sensor: _Sensor, measurement: Measurement, others: int | None) -> Passed:
        stamp = measurement.stamp
        if self._clock_jumped:
            if self._clock_refuted is None:
                self._clock_refuted = stamp + LONGEST_PATIENCE
            self._clock_jumped = stamp <= self._clock_refuted
        self._drop(measurement.sensor, sensor, len(sensor.held))
        sensor.held = []
        if sensor.went_on == 0 or stamp > sensor.newest or sensor.away:
            # One whose stamps stand still has no say.
            if sensor.went_on and not sensor.away:
                sensor.steps.append(stamp - sensor.newest)
            sensor.newest, sensor.heard = stamp, self._order
            sensor.went_on += 1
            if others is not None:
                sensor.lags.append(others - stamp)
                sensor.all_lags.append(others - stamp)
        sensor.away, sensor.alone, sensor.away_since = 0, False, {}
        return Passed((measurement,))

    def _realigned(
        self, sensor: _Sensor, measurement: Measurement, others: int | None
    ) -> Measurement:
        """A measurement of a sensor whose clock stepped, as if it had not, unless it came back."""
        moved = self.moved(measurement)
        if others is None:
            return moved
        # Its own stamps go on either way where the step was hardly larger than its period.
        usual = others - sensor.lag
        as_it_is, as_moved = abs(usual - measurement.stamp), abs(usual - moved.stamp)
        if as_it_is > self._slack() or as_it_is > as_moved:
            return moved
        sensor.shift = 0
        return measurement

    def _hold(self, sensor: _Sensor, measurement: Measurement, others: int | None) -> Passed:
        name, stamp = measurement.sensor, measurement.stamp
        if sensor.away == 0:
            sensor.away_since = {other: item.went_on for other, item in self._sensors.items()}
        sensor.away += 1
        if stamp < sensor.newest and self._policy is TimeJumpPolicy.IGNORE:
            self.drops[name, 'time_jump'] += 1
            self._tell_of_step(name, sensor, stamp)
            return Passed(())
        held = sensor.held
        if held and not -self._threshold <= stamp - held[-1].stamp <= OWN_AGREEMENT:
            self._drop(name, sensor, len(held))
            held.clear()
        behind = 0 if others is None else others - stamp
        held.append(_Held(measurement, self._order, behind, sensor.away))
        while len(held) > WITNESSES_ANEW and stamp - held[0].stamp > HOLD:
            self._drop(name, sensor, 1)
            del held[0]
        group = self._shared(name, sensor)
        if group is None:
            self._tell_of_step(name, sensor, stamp)
            return Passed(())
        witnesses = [item for member in group.values() for item in member.held]
        return self._jump(group, sorted(witnesses, key=lambda item: item.order))

    def _shared(self, name: str, sensor: _Sensor) -> dict[str, _Sensor] | None:
        """The sensors that share a jump, None where one of those alive does not, or not yet."""
        group = {name: sensor}
        last, forwards = sensor.held[-1].stamp, sensor.held[-1].stamp > sensor.newest
        top = max((item.newest for item in self._sensors.values()), default=last)
        staying = 0
        for other, item in self._sensors.items():
            if item is sensor:
                continue
            if item.held and abs(item.held[-1].stamp - last) <= AGREEMENT:
                if (item.held[-1].stamp > item.newest) is forwards:
                    group[other] = item
                continue
            if item.away or top - item.newest - max(item.lag, 0) > item.patience:
                continue  # elsewhere, or silent since long before
            there = abs(item.newest - last) <= AGREEMENT
            if there and item.begun > sensor.heard:
                continue  # began there, when this one had left its time already
            after = next((it.stamp for it in sensor.held if it.order > item.heard), last)
            if last - after <= item.patience:
                if there:
                    return None
                staying += 1
        # Where nobody can measure the steps the larger part is right, or all would be left out.
        if staying and (staying >= len(group) or not all(item.alone for item in group.values())):
            return None
        # What is on its way when the clock went back still belongs to the time before.
        if self._clock_jumped and not forwards:
            return group
        stamps = [held.stamp for item in group.values() for held in item.held]
        usual = sum(item.went_on_beyond(item.step) for item in group.values())
        anew = sum(item.went_on_beyond(item.held_step()) for item in group.values())
        far = abs(last - sensor.newest) > _LONGEST_PAUSE
        enough = (usual >= WITNESSES or anew >= WITNESSES_ANEW) and len(sensor.held) > 1
        if far and max(stamps) - min(stamps) < FAR_PROOF:
            return None
        return group if enough else None

    def _tell_of_step(self, name: str, sensor: _Sensor, stamp: int) -> None:
        """Keep that a clock stepped, where it goes on like that and others as before."""
        if sensor.away < WITNESSES or sensor.alone:
            return
        live = [
            other
            for other, item in self._sensors.items()
            if other != name and item.went_on >= sensor.away_since.get(other, 0) + ALONE
        ]
        # Messages of the time before are on their way for a moment.
        if not live or (sensor.held and stamp - sensor.held[0].stamp < NANOSECONDS):
            return
        sensor.alone = True
        newest = max(self._sensors[other].newest for other in live)
        beyond = [Beyond(item.stamp, item.behind, item.number) for item in sensor.held]
        size = step_size(sensor.newest, sensor.steps, sensor.all_lags, beyond)
        follows = size is not None and sensor.realigned < MOST_REALIGNED
        told = stamp + sensor.lag - newest if size is None else size
        step = ClockStep(sensor.shift + told, tuple(live), follows)
        self.steps = {**self.steps, name: step}
        if size is not None and follows:
            self._realign(name, sensor, size)

    def _realign(self, name: str, sensor: _Sensor, size: int) -> None:
        """Follow a sensor whose clock stepped from now on."""
        last = sensor.held[-1]
        self._drop(name, sensor, len(sensor.held))
        sensor.held = []
        sensor.shift += size
        sensor.realigned += 1
        sensor.newest, sensor.heard = last.stamp - size, self._order
        sensor.away, sensor.alone, sensor.away_since = 0, False, {}
        sensor.apart.clear()

    def _drop(self, name: str, sensor: _Sensor, count: int) -> None:
        """Count held messages that are left out."""
        if count:
            ahead = sensor.held[0].stamp > sensor.newest
            stray = 'stamp_leap' if ahead else 'stray_stamp'
            self.drops[name, 'clock_step' if sensor.alone else stray] += count

    def _jump(self, group: dict[str, _Sensor], witnesses: list[_Held]) -> Passed:
        """All sensors that are alive went somewhere: what was before is no measure any more."""
        by = witnesses[0].stamp - group[witnesses[0].measurement.sensor].newest
        anew = not 0 <= by <= _LONGEST_PAUSE
        for name, sensor in self._sensors.items():
            if name not in group:
                self._drop(name, sensor, len(sensor.held))
        # Who is silent now is new when it comes back.
        self._sensors = group
        for item in witnesses:
            sensor = group[item.measurement.sensor]
            sensor.newest, sensor.heard = item.stamp, item.order
            sensor.held, sensor.away, sensor.alone = [], 0, False
            sensor.shift = 0 if anew else sensor.shift
        self._clock_jumped = False
        self.steps = {name: step for name, step in self.steps.items() if name not in group}
        self.jumps += anew
        return Passed(tuple(item.measurement for item in witnesses), jumped=anew)
