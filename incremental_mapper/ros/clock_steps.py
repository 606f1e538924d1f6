"""One sensor's clock that was set while the others' went on: by how much, and what is said."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median_low

from incremental_mapper.checks.finding import Finding, Severity, listed
from incremental_mapper.checks.sensor_clocks import setting_name, setting_tree
from incremental_mapper.measurements import NANOSECONDS

FEWEST_STEPS = 8
"""So many steps tell a sensor's period."""
REGULAR = 0.2
"""Share of the period by which half of the steps may differ from it."""
SLACK = NANOSECONDS // 50
"""Nanoseconds by which the size by the sensor's own period and that by the others' stamps may
differ in any case: how long messages take is not known better."""
ON_GRID = 0.25
"""Share of the period by which they may differ besides whole periods: messages that were lost."""
FIRST = 5
"""Messages behind the step whose stamps tell its size: further on the period's own error counts."""
MOST_REALIGNED = 3
"""A clock that was set so often is not followed any more."""


@dataclass(frozen=True, slots=True)
class ClockStep:
    """A sensor's clock that stepped alone.

    Attributes:
        size: By how many nanoseconds.
        live: The sensors that did not take part.
        followed: Whether its stamps are put right since.
    """

    size: int
    live: tuple[str, ...]
    followed: bool


@dataclass(frozen=True, slots=True)
class Beyond:
    """A message behind a step: its stamp, and how far the others' newest was beyond it (ns).

    ``number`` counts the sensor's messages since the last one before the step.
    """

    stamp: int
    behind: int
    number: int


def step_size(
    newest: int, steps: Sequence[int], lags: Sequence[int], beyond: Sequence[Beyond]
) -> int | None:
    """By how much a sensor's clock stepped.

    A sensor that measures at a steady rate tells that itself: what comes next is due a period
    later. The others' stamps, of which one never knows how long they took, must agree, and tell
    how many messages were lost in between.

    Args:
        newest: Its last stamp before the step, ns.
        steps: From stamp to stamp before it, ns.
        lags: How far it was behind the others' newest stamp, ns; of a second or more.
        beyond: Its messages since, in the order in which they came; as many or more.

    Returns:
        Nanoseconds; None where that is not certain.
    """
    if len(steps) < FEWEST_STEPS or not lags or not beyond:
        return None
    period = median_low(steps)
    if period <= 0 or median_low([abs(step - period) for step in steps]) > REGULAR * period:
        return None
    by_period = median_low([it.stamp - newest - it.number * period for it in beyond[:FIRST]])
    by_others = median_low(lags) - median_low([it.behind for it in beyond])
    apart = by_period - by_others
    if abs(apart) <= SLACK:
        return by_period
    lost = max(round(apart / period), 0)
    if abs(apart - lost * period) > max(ON_GRID * period, SLACK):
        return None
    return by_period - lost * period


def step_findings(
    steps: Mapping[str, ClockStep], offsets: Mapping[str, float]
) -> tuple[Finding, ...]:
    """Say which sensors' clocks stepped alone.

    Args:
        steps: By sensor.
        offsets: The sensors' ``time_offset`` so far, seconds.
    """
    found = []
    for sensor, step in steps.items():
        seconds = offsets.get(sensor, 0.0) - step.size / NANOSECONDS
        follows = (
            f'its stamps are moved by {-step.size / NANOSECONDS:+.3f} s until it steps back'
            if step.followed
            else 'it is left out until their stamps agree again as before'
        )
        found.append(
            Finding(
                'clock_step',
                Severity.WARNING,
                sensor,
                f'its clock stepped by {step.size / NANOSECONDS:+.3f} s against '
                f'{listed(step.live)}; {follows}',
                f'set its clock right, or {setting_name(sensor)}: {seconds:.3f} for the next start',
                setting_tree(sensor, seconds),
            )
        )
    return tuple(found)
