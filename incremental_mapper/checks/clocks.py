"""Clocks: stamps against the times of recording, and the sensors against each other.

What a message's record time is later than its stamp is its lag: latency, and the difference of two
clocks. Latency is small and alike; one recorder's clock is the same for all sensors. So a sensor
whose lag is unlike the others' has another clock, even where the recorder's own clock is wrong, or
the recording is played faster than it was made.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding, Severity, listed
from incremental_mapper.checks.sensor_clocks import SensorClock, setting_line
from incremental_mapper.checks.time_scales import known_offset
from incremental_mapper.checks.time_spans import span_findings
from incremental_mapper.measurements import NANOSECONDS

MOST_LATENCY = 1.0
"""Seconds by which lags of sound sensors differ at most. Real bags have 0 to 0.1 (Ouster, whose
stamp is the start of the sweep), drivers of LiDARs are known for up to 0.3, receivers that wait
for corrections for up to 1."""
BACKLOG = 5.0
"""Seconds; stamps that far behind may also come from a full queue before the recorder, so what is
less is not mended but told. Stamps ahead are never latency."""
SCALE_TOLERANCE = 0.45
"""Seconds by which a difference may miss that of two time scales: the latencies differ."""
EARLY = 0.3
"""Seconds by which a stamp may lie after its record time. Real bags have 0."""
SAME_CLOCK, SAME_LIDAR_CLOCK = 0.25, 0.05
"""Seconds by which lags of sensors on one clock differ, at most; two LiDARs, which have the same
latency, less. They are moved together, so that what they agree on stays."""
SHORTEST_STEP = 0.1
"""Seconds; a clock that steps by more in the recording is told: at 10 m/s the map is torn by as
many metres. What the lags vary beside must be a third of it at the most."""
SMALLEST_DRIFT = 0.05
"""Seconds that a clock drifts away from the others until it is told: what a car of 20 m/s moves in
it is a metre. Latencies vary by less; so it takes 500 s of an unsynchronised clock of 100 ppm."""
_MOST_DRIFT = 1e-3
"""Seconds a second; no clock of quartz is that bad. Messages that come later and later, from a
queue that fills, look like a clock that is slower than that; nothing but a clock looks faster."""
_SPREAD = 0.5
"""Seconds; a lag that varies more is no constant difference of two clocks."""
_STEADY = 0.25
"""Seconds; a lag that varies less is that of a clock that does not step."""
_REST = 0.3
"""Share of a step by which lags may vary beside it."""
_BINS = 16
_PACE = 0.02
"""Record times that run so differently from the stamps are of a playback."""
_SAME_PACE = 1.25
_STANDING = 0.1
"""Record times that pass so much slower than the stamps of every sensor stand still."""
_YOUNG = 10 * 366 * 86400 * NANOSECONDS
"""A stamp before 1980 counts from power-up."""


@dataclass(frozen=True, slots=True, eq=False)
class _Lag:
    """Lag of one sensor along the recording.

    Attributes:
        clock: whose it is.
        times: (K,) record times in nanoseconds.
        lags: (K,) nanoseconds.
        pace: seconds of the stamps in a second of the record times, NaN where that is not known.
    """

    clock: SensorClock
    times: NDArray[np.int64]
    lags: NDArray[np.int64]
    pace: float

    @property
    def middle(self) -> int:
        return int(np.median(self.lags - self.lags[0])) + int(self.lags[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Sensors on one clock, the smallest lag among them (ns), and their newest stamp.

    Without a sensor it is the recorder.
    """

    lags: tuple[_Lag, ...]
    lag: int
    newest: int

    @property
    def names(self) -> list[str]:
        return [lag.clock.sensor for lag in self.lags] or ['the recorder']


def clock_findings(clocks: Sequence[SensorClock], by_spans: bool = True) -> tuple[Finding, ...]:
    """Find sensors on another clock than the rest.

    Args:
        clocks: some stamps of every sensor, spread over the recording.
        by_spans: whether first and last stamps may tell where record times do not.

    Returns:
        ``clock_offset`` (mended where the number is certain, else told), ``clock_step``,
        ``clock_drift``, ``future_stamps``, ``no_common_time``.
    """
    clocks = [clock for clock in clocks if len(clock.stamps)]
    lags = _lags(clocks)
    if lags is None:
        return span_findings(clocks) if by_spans else ()
    steps = _steps(lags)
    stepping = {step.sensor for step in steps}
    steady = [lag for lag in lags if lag.clock.sensor not in stepping]
    found = list(steps)
    if len(steady) > 1:
        groups, relative = _grouped(steady)
        reference = _reference(groups, steady, relative)
        for group in groups:
            if group is not reference:
                found += _offsets(group, reference, relative)
        found += _early(reference, steady)
        found += _drifts(reference)
    return tuple(found)


def _lags(clocks: Sequence[SensorClock]) -> list[_Lag] | None:
    """Lags of the sensors, or None where the record times tell nothing."""
    lags, spans = [], []
    for clock in clocks:
        if clock.received is None:
            return None
        lags.append(_lag(clock, clock.received))
        spans.append((np.ptp(clock.received), np.ptp(clock.stamps)))
    # A converter that has no record times writes the stamps in their place.
    if all(not lag.lags.any() for lag in lags):
        return None
    # Or one moment for all of them.
    if all(passed < _STANDING * moved for passed, moved in spans if moved):
        return None
    paces = [lag.pace for lag in lags if np.isfinite(lag.pace)]
    if paces and not 0.1 < min(paces) <= max(paces) < 10.0:
        return None
    return None if paces and max(paces) > _SAME_PACE * min(paces) else lags


def _lag(clock: SensorClock, received: NDArray[np.int64]) -> _Lag:
    """The middle one of the lags in every sixteenth of the recording, and its record time."""
    order = np.argsort(received, kind='stable')
    times, stamps = received[order], clock.stamps[order]
    lags = times - stamps - clock.lead
    span = max(int(times[-1] - times[0]), 1)
    bins = (times - times[0]) * _BINS // (span + 1)
    picked = []
    for number in np.unique(bins):
        inside = np.flatnonzero(bins == number)
        # A stray stamp among them is not in the middle.
        picked.append(inside[np.argsort(lags[inside], kind='stable')[(len(inside) - 1) // 2]])
    chosen = np.array(picked)
    passed, moved = np.diff(times[chosen]), np.diff(stamps[chosen])
    pace = float(np.median(moved / np.maximum(passed, 1))) if len(chosen) > 2 else np.nan
    return _Lag(clock, times[chosen], lags[chosen], pace)


def _grouped(lags: Sequence[_Lag]) -> tuple[list[_Group], bool]:
    """Sensors by clock; and whether only differences count, as in a playback."""
    paces = [lag.pace for lag in lags if np.isfinite(lag.pace)]
    relative = any(abs(pace - 1.0) > _PACE for pace in paces)
    anchor = max(lags, key=lambda lag: len(lag.clock.stamps))
    base = anchor.middle
    middles = {lag.clock.sensor: base + _against(lag, anchor) for lag in lags}
    groups: list[list[_Lag]] = []
    for lag in sorted(lags, key=lambda lag: middles[lag.clock.sensor]):
        place = middles[lag.clock.sensor]
        home = next((g for g in groups if _one_clock(g, lag, middles, place)), None)
        if home is None:
            groups.append([lag])
        else:
            home.append(lag)
    made = [_group(group, min(middles[lag.clock.sensor] for lag in group)) for group in groups]
    return made, relative


def _group(lags: Sequence[_Lag], lag: int) -> _Group:
    return _Group(tuple(lags), lag, max(one.clock.last for one in lags))


def _one_clock(group: Sequence[_Lag], lag: _Lag, middles: dict[str, int], place: int) -> bool:
    """Whether a sensor's lag is that of a group, sensor by sensor."""
    for other in group:
        lidars = other.clock.is_lidar and lag.clock.is_lidar
        most = SAME_LIDAR_CLOCK if lidars else SAME_CLOCK
        if abs(middles[other.clock.sensor] - place) > most * NANOSECONDS:
            return False
    return True


def _against(lag: _Lag, anchor: _Lag) -> int:
    """How much a lag is more than the anchor's, at the same record times (ns)."""
    start = anchor.times[0]
    base = anchor.lags[0]
    at = np.interp(
        (lag.times - start).astype(float),
        (anchor.times - start).astype(float),
        (anchor.lags - base).astype(float),
    )
    return int(np.median((lag.lags - base).astype(float) - at))


def _reference(groups: Sequence[_Group], lags: Sequence[_Lag], relative: bool) -> _Group:
    """The clock that is right, with all groups that differ from it by latency only.

    The one that the record times agree with; else what most sensors have; then one that tells a
    date, that the receiver has, and that is behind: TAI and GPS time are ahead of UTC. Where each
    sensor has its own, and one is in a time scale that the record times know, these are right.
    """

    def rank(group: _Group) -> tuple[bool, int, bool, bool, int]:
        agrees = -EARLY <= group.lag / NANOSECONDS <= MOST_LATENCY
        near = [other for other in groups if _close(other, group)]
        dated = max(lag.clock.last for lag in group.lags) > _YOUNG
        return (
            agrees,
            sum(len(other.lags) for other in near),
            dated,
            'gnss' in group.names,
            group.lag,
        )

    best = max(groups, key=rank)
    recorder = _Group((), 0, max(int(lag.times[-1]) for lag in lags))
    agrees, shared, *_ = rank(best)
    alone = not (agrees or relative) and shared == 1
    if alone and any(_known(group, recorder) for group in groups):
        return recorder
    return _group(
        [lag for group in groups if _close(group, best) for lag in group.lags],
        min(group.lag for group in groups if _close(group, best)),
    )


def _known(group: _Group, recorder: _Group) -> bool:
    """Whether a group has a time scale that differs from the recorder's as two scales do."""
    return known_offset(-group.lag / NANOSECONDS, recorder.newest, SCALE_TOLERANCE) is not None


def _close(one: _Group, other: _Group) -> bool:
    return abs(one.lag - other.lag) <= MOST_LATENCY * NANOSECONDS


def _offsets(group: _Group, reference: _Group, relative: bool) -> list[Finding]:
    """What is wrong with a group of sensors that is not on the reference's clock."""
    if _close(group, reference):
        return []
    ahead = reference.lag - group.lag
    seconds = ahead / NANOSECONDS
    utc = reference.newest
    young = max(lag.clock.last for lag in group.lags) < _YOUNG
    spread = max(float(np.ptp(lag.lags)) for lag in group.lags) / NANOSECONDS
    steady = not -BACKLOG < seconds < 0.0 and (relative or spread < _SPREAD)
    by = 'when they came in' if relative else 'their record times'
    found = []
    for lag in group.lags:
        clock = lag.clock
        # What the clock is by itself, not what the settings made of it.
        own = known_offset((ahead - clock.offset) / NANOSECONDS, utc, SCALE_TOLERANCE)
        if own is not None:
            correction = -own[0] * NANOSECONDS - clock.offset
            what, how = f': {own[1]}', ''
        else:
            correction = -ahead
            what = ': they count from power-up' if young else ''
            how = f', aligned by {by}: exact but for the latency of its messages'
        line, tree = setting_line(clock, correction)
        exact = own[0] if own is not None and not clock.offset else seconds
        text = (
            f'stamps are {_seconds(abs(exact))} s {"ahead of" if ahead > 0 else "behind"} those '
            f'of {listed(reference.names)} by {by}{what}'
        )
        mended = (steady or own is not None) and not clock.chosen
        remedy = f'mended as with {line}{how}' if mended else f'set {line}'
        severity = Severity.MENDED if mended else Severity.WARNING
        found.append(Finding('clock_offset', severity, clock.sensor, text, remedy, tree))
    return found


def _seconds(value: float) -> str:
    return f'{value:.2f}' if value < 1e4 else f'{value:.1f}'


def _early(reference: _Group, lags: Sequence[_Lag]) -> list[Finding]:
    """Sensors whose stamps lie after their record times, where those of another do not."""
    found = []
    sound = [lag for lag in lags if -EARLY <= lag.middle / NANOSECONDS <= MOST_LATENCY]
    if not sound:
        return []
    for lag in reference.lags:
        early = -lag.middle / NANOSECONDS
        if early > EARLY and abs(lag.pace - 1.0) < _PACE:
            line, tree = setting_line(lag.clock, lag.middle)
            found.append(
                Finding(
                    'future_stamps',
                    Severity.WARNING,
                    lag.clock.sensor,
                    f'stamps lie {early:.2f} s after their record times: its clock is ahead',
                    f'set {line}, less the latency of its messages',
                    tree,
                )
            )
    return found


def _steps(lags: Sequence[_Lag]) -> list[Finding]:
    """Sensors whose clock steps in the recording while another's does not."""
    steps: dict[str, tuple[int, int, int]] = {}
    for lag in lags:
        step = _step(lag)
        if step is not None:
            steps[lag.clock.sensor] = step
    # Where none is steady, it is the recorder: a pause, a bag that is played in a loop.
    steady = min(
        (float(np.ptp(lag.lags)) for lag in lags if len(lag.lags) > 1), default=float(np.inf)
    )
    if steady > _STEADY * NANOSECONDS:
        return []
    steps = {name: step for name, step in steps.items() if steady < _REST * abs(step[0])}
    start = min(int(lag.times[0]) for lag in lags)
    others = [lag.clock.sensor for lag in lags if lag.clock.sensor not in steps]
    against = f' and {listed(others)}' if others else ''
    return [
        Finding(
            'clock_step',
            Severity.WARNING,
            sensor,
            f'its clock steps by {-size / NANOSECONDS:+.2f} s against the record times{against}, '
            f'between {(before - start) / NANOSECONDS:.1f} s and '
            f'{(after - start) / NANOSECONDS:.1f} s',
            'no time_offset mends it: cut the recording there, and synchronise the clocks before '
            'the next one',
        )
        for sensor, (size, before, after) in steps.items()
    ]


def _step(lag: _Lag) -> tuple[int, int, int] | None:
    """The largest step of a lag (ns), and the record times before and after it."""
    values = (lag.lags - lag.lags[0]) / NANOSECONDS
    if len(values) < 4 or not abs(lag.pace - 1.0) < _PACE:
        return None
    at = int(np.argmax(np.abs(np.diff(values)))) + 1
    before, after = values[:at], values[at:]
    if min(len(before), len(after)) < 2:
        return None
    size = float(np.median(after) - np.median(before))
    rest = max(float(np.ptp(before)), float(np.ptp(after)))
    if abs(size) < SHORTEST_STEP or rest > _REST * abs(size):
        return None
    return round(size * NANOSECONDS), int(lag.times[at - 1]), int(lag.times[at])


def _drifts(reference: _Group) -> list[Finding]:
    """Sensors whose clock runs faster or slower than the record times, where others' do not."""
    if not reference.lags or any(abs(lag.pace - 1.0) > _PACE for lag in reference.lags):
        return []
    drifts = {lag.clock.sensor: _drift(lag) for lag in reference.lags}
    ordered = sorted(drifts.values(), key=abs)
    # The recorder's own clock may be the one that drifts: then it is most of them.
    usual = float(np.median(ordered)) if len(ordered) > 2 else ordered[0]
    found = []
    for lag in reference.lags:
        away = drifts[lag.clock.sensor] - usual
        if abs(away) < SMALLEST_DRIFT:
            continue
        span = int(lag.times[-1] - lag.times[0]) / NANOSECONDS
        found.append(
            Finding(
                'clock_drift',
                Severity.WARNING,
                lag.clock.sensor,
                f'its clock drifts by {-away:+.3f} s in {span:.0f} s against the other sensors '
                f'({-away / span * 1e6:+.0f} ppm)',
                'synchronise the clocks (PTP, PPS) before the next recording; a part of it can be '
                f'mapped with time_offset {away / 2:+.3f} s at its middle',
            )
        )
    return found


def _drift(lag: _Lag) -> float:
    """Seconds by which a lag grows in the recording, 0 where that is not sure."""
    if len(lag.lags) < 6:
        return 0.0
    times = (lag.times - lag.times[0]) / NANOSECONDS
    values = (lag.lags - lag.lags[0]) / NANOSECONDS
    slope, start = np.polyfit(times, values, 1)
    noise = float(np.std(values - (slope * times + start)))
    grown = float(slope * times[-1])
    sure = abs(grown) > 10.0 * noise and -_PACE < slope < _MOST_DRIFT
    return grown if sure else 0.0


def unstamped_finding(sensor: str, looked_at: int, replaced: bool) -> Finding:
    """Say that a driver sets no header stamps.

    Args:
        sensor: whose messages they are.
        looked_at: messages that were looked at; all have a stamp of zero.
        replaced: whether record times stand in for the stamps.
    """
    if replaced:
        text = (
            f'all {looked_at} stamps that were looked at are zero; record times stand in for them'
        )
        remedy = 'right but for the latency of its messages; let its driver set header stamps'
    else:
        text = f'all {looked_at} stamps looked at are zero, and record times tell nothing'
        remedy = 'it cannot be used; let its driver set header stamps, and record again'
    return Finding('no_stamps', Severity.WARNING, sensor, text, remedy)
