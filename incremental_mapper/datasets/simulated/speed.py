"""Speed over time as a chain of smooth ramps; speed, its integral and its slope are exact."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.datasets.simulated.options import MotionKind
from incremental_mapper.datasets.simulated.route import Route
from incremental_mapper.datasets.simulated.smooth_step import step, step_integral, step_slope

Array = NDArray[np.float64]

CRUISE = 20.0 / 3.6
APPROACH = 22.0 / 3.6
RATE = 1.1
"""Mean acceleration of a ramp in mixed traffic, m/s^2; the peak is 35/16 of it."""
HURRY = 1.5
"""Mean acceleration that a short acceleration or deceleration drive may have, m/s^2."""
LATERAL = 2.3
"""Largest lateral acceleration in a bend of mixed traffic, m/s^2."""
NOTICEABLE = 1.0
"""Nobody changes the speed by less, in m/s; so short a ramp would rock the car."""
LEAD = 18.0
"""Distance from the start of a mixed drive to the first bend, metres."""
HEADWAY = 5.0
"""Distance from the beginning of the road to the start of the other drives, metres."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """``seconds`` in which the speed goes from ``start`` to ``end`` m/s."""

    seconds: float
    start: float
    end: float

    @property
    def distance(self) -> float:
        """Metres covered; the step is symmetric, so the mean speed is the middle one."""
        return self.seconds * (self.start + self.end) / 2.0


class SpeedProfile:
    """Arc length, speed and acceleration at any time; constant speed before and after."""

    def __init__(self, ramps: list[Ramp], start_arc: float) -> None:
        self._seconds = np.array([ramp.seconds for ramp in ramps])
        self._starts = np.concatenate([[0.0], np.cumsum(self._seconds)[:-1]])
        self._speeds = np.array([ramp.start for ramp in ramps])
        self._gains = np.array([ramp.end - ramp.start for ramp in ramps])
        distances = np.cumsum([ramp.distance for ramp in ramps])
        self._arcs = start_arc + np.concatenate([[0.0], distances[:-1]])

    def __call__(self, times: Array) -> tuple[Array, Array, Array]:
        """Arc length (N,) m, speed (N,) m/s, acceleration (N,) m/s^2 at ``times`` (N,) s."""
        index = np.maximum(np.searchsorted(self._starts, times, side='right') - 1, 0)
        since = times - self._starts[index]
        length = self._seconds[index]
        gain = self._gains[index]
        u = since / length
        late = np.maximum(since - length, 0.0)
        arc = (
            self._arcs[index]
            + self._speeds[index] * since
            + gain * (length * step_integral(u) + late)
        )
        return arc, self._speeds[index] + gain * step(u), gain / length * step_slope(u)


def make_profile(
    kind: MotionKind, duration: float, route: Route, rng: np.random.Generator
) -> SpeedProfile:
    """The speed profile of a drive of ``duration`` seconds along ``route``."""
    if kind is MotionKind.MIXED:
        first = min(LEAD, route.pieces[0].length)
        ramps = _mixed(duration, route, first, rng)
        return SpeedProfile(ramps, route.pieces[0].length - first)
    if kind is MotionKind.ZERO:
        ramps = [Ramp(duration, 0.0, 0.0)]
    elif kind is MotionKind.CONST:
        ramps = [Ramp(duration, CRUISE, CRUISE)]
    elif kind is MotionKind.ACCEL:
        seconds = min(0.75 * duration, CRUISE / 0.9)
        speed = min(CRUISE, HURRY * seconds)
        wait = 0.08 * duration
        ramps = [Ramp(wait, 0.0, 0.0), Ramp(seconds, 0.0, speed)]
    else:
        seconds = min(0.75 * duration, APPROACH / 0.9)
        speed = min(APPROACH, HURRY * seconds)
        wait = 0.92 * duration - seconds
        ramps = [Ramp(wait, speed, speed), Ramp(seconds, speed, 0.0)]
    return SpeedProfile(ramps, HEADWAY)


def _mixed(duration: float, route: Route, first: float, rng: np.random.Generator) -> list[Ramp]:
    """Traffic: a standing start, slower bends, stops before some of them, a stand at the end.

    ``first`` is the rest of the first stretch of road in metres.
    """
    ramps = [Ramp(min(1.0, 0.1 * duration), 0.0, 0.0)]
    left = duration - 0.5 - ramps[0].seconds
    for ramp in _traffic(route, first, rng):
        if ramp.seconds + _change(ramp.end, 0.0).seconds > left:
            # Time is up: a part of a steady stretch still fits, a part of a change does not.
            stop = _change(ramp.start, 0.0)
            if ramp.start == ramp.end and left > stop.seconds:
                ramps.append(Ramp(left - stop.seconds, ramp.start, ramp.start))
            if stop.seconds > 0.0:
                ramps.append(stop)
            break
        ramps.append(ramp)
        left -= ramp.seconds
    return ramps


def _traffic(route: Route, first: float, rng: np.random.Generator) -> Iterator[Ramp]:
    """Endless ramps along the pieces of a route, which alternate between straights and bends."""
    speed = 0.0
    length = first
    straights = route.pieces[0::2]
    bends = route.pieces[1::2]
    for lap in itertools.count():
        for number, piece in enumerate(bends):
            if (lap, number) != (0, 0):
                length = straights[number].length
            limit = min(CRUISE * 1.2, math.sqrt(LATERAL / piece.curvature))
            halt = rng.random() < 0.4 and (lap, number) != (0, 0)
            cruise = max(rng.uniform(6.1, 8.3), limit)
            for ramp in _straight(length, speed, cruise, 0.0 if halt else limit):
                yield ramp
                speed = ramp.end
            if speed == 0.0:
                yield Ramp(rng.uniform(1.5, 3.0), 0.0, 0.0)
            for ramp in _straight(piece.length, speed, limit, limit):
                yield ramp
                speed = ramp.end


def _straight(length: float, start: float, cruise: float, end: float) -> list[Ramp]:
    """Ramps that cover ``length`` metres between two speeds, with ``cruise`` m/s where it fits."""
    top = max(start, end)
    peak = min(cruise, math.sqrt(RATE * length + (start**2 + end**2) / 2.0))
    if top < peak < top + NOTICEABLE:
        peak = top
    if peak < top:
        # Too short for the usual rate: one ramp over all of it.
        return [Ramp(2.0 * length / (start + end), start, end)]
    ramps = [_change(start, peak), _change(peak, end)]
    steady = (length - ramps[0].distance - ramps[1].distance) / peak
    ramps.insert(1, Ramp(steady, peak, peak))
    return [ramp for ramp in ramps if ramp.seconds > 1e-6]


def _change(start: float, end: float) -> Ramp:
    return Ramp(abs(end - start) / RATE, start, end)
