"""Whether inputs and worker are well: levels from the last period, on plain numbers.

Counts are those since the beginning; what is judged is their growth. Times are seconds on a steady
clock.
"""

from collections import Counter, deque
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from statistics import median
from typing import TypeVar

Key = TypeVar('Key', bound=Hashable)

SILENT = (2.0, 1.0)
"""An input is silent after so many of its own periods, and so many seconds at least."""
DEAD = (10.0, 5.0)
"""The same for one that is taken for dead."""
UNKNOWN_PERIOD = 5.0
"""Seconds of silence after a first message, while its period is not known."""
JUDGED_PERIODS = 3.0
"""Periods of its own over which an input's rejected messages are counted at least."""
MANY, NEARLY_ALL = 0.5, 0.8
"""Shares of rejected messages from which on it is a warning, and an error."""
NO_WINDOW = 5.0
"""Seconds without a window, while data come in, that are an error; more where windows wait long."""
SHOWN = 10.0
"""Seconds for which an event of a moment is shown."""
PERIODS_KEPT = 9
"""Looks from which an input's period is known."""
LOOKS_KEPT = 100
"""Looks behind which nothing is counted."""

WANTED = frozenset({'paused', 'switched_off'})
"""Reasons that are somebody's wish."""
AFTERWARDS = frozenset({'before_mend', 'datum_outlier'})
"""Reasons that throw away what was taken in earlier: no share of what came in meanwhile."""
LOSSES = frozenset({'queue_full', 'overload', 'late', 'window_failed', 'mapper_failed', 'shutdown'})
"""Reasons that say nothing against the message: one is worth a warning."""


class Level(IntEnum):
    """Levels of ``diagnostic_msgs/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Verdict:
    """How something is."""

    level: Level
    message: str


@dataclass(frozen=True, slots=True)
class InputCounts:
    """What is known of an input.

    ``heard`` is when its newest message was taken, None before the first; ``lost`` is what the
    middleware lost, ``dropped`` what was not used by reason.
    """

    received: int
    heard: float | None
    lost: int
    dropped: Mapping[str, int]


class InputVitals:
    """Watches one input; to be looked at once a period of the diagnostics."""

    def __init__(self, needed: bool) -> None:
        """``needed`` tells whether rejecting all is an error: not so for fixes in a tunnel."""
        self._needed = needed
        self._looks: deque[tuple[float, InputCounts]] = deque(maxlen=LOOKS_KEPT)
        self._periods: deque[float] = deque(maxlen=PERIODS_KEPT)

    @property
    def period(self) -> float | None:
        """Seconds between two messages, as a rule; None while it is not known."""
        return median(self._periods) if self._periods else None

    @property
    def patience(self) -> float:
        """Seconds without a message after which the input is silent."""
        return self._limit(SILENT)

    def look(self, now: float, counts: InputCounts) -> Verdict:
        """Judge the time since the last look.

        Args:
            now: The time.
            counts: What is known by now.
        """
        self._learn(counts)
        since = self._before(now, counts)
        self._looks.append((now, counts))
        received = counts.received - since.received
        if counts.heard is None:
            return Verdict(Level.WARN, 'no message yet')
        silent = now - counts.heard
        if silent > self.patience:
            level = Level.ERROR if silent > self._limit(DEAD) else Level.WARN
            return Verdict(level, f'no message for {silent:.1f} s')
        dropped = grown(counts.dropped, since.dropped)
        rejected = Counter(
            {
                reason: count
                for reason, count in dropped.items()
                if reason not in WANTED | AFTERWARDS | LOSSES
            }
        )
        share = rejected.total() / received if received > 0 else 0.0
        if share >= MANY:
            error = share >= NEARLY_ALL and self._needed
            reasons = ', '.join(reason for reason, _ in rejected.most_common())
            few = min(rejected.total(), received)
            text = f'{few} of {received} messages cannot be used: {reasons}'
            return Verdict(Level.ERROR if error else Level.WARN, text)
        lost = max(counts.lost - since.lost, 0)
        if lost:
            return Verdict(Level.WARN, f'{lost} messages lost on the way')
        losses = [f'{count} {reason}' for reason, count in dropped.items() if reason in LOSSES]
        if losses:
            return Verdict(Level.WARN, f'messages lost: {", ".join(losses)}')
        return Verdict(Level.OK, '')

    def _limit(self, kind: tuple[float, float]) -> float:
        periods, least = kind
        known = self.period
        return UNKNOWN_PERIOD if known is None else max(periods * known, least)

    def _learn(self, counts: InputCounts) -> None:
        """Take the mean distance of the messages since the last look."""
        last = self._looks[-1][1] if self._looks else None
        if last is None or last.heard is None or counts.heard is None:
            return
        if counts.received > last.received and counts.heard > last.heard:
            self._periods.append((counts.heard - last.heard) / (counts.received - last.received))

    def _before(self, now: float, counts: InputCounts) -> InputCounts:
        """The counts from which on messages are judged; those of the last look for most inputs."""
        span = JUDGED_PERIODS * (self.period or 0.0)
        for at, before in reversed(self._looks):
            if now - at >= span:
                return before
        return self._looks[0][1] if self._looks else InputCounts(0, None, counts.lost, {})


def grown(counts: Mapping[Key, int], before: Mapping[Key, int]) -> Counter[Key]:
    """What came to counts; one that is smaller than before began anew."""
    return +Counter(
        {
            key: count - before.get(key, 0) if count >= before.get(key, 0) else count
            for key, count in counts.items()
        }
    )


class Flow:
    """Watches whether windows come out where data come in."""

    def __init__(self, patience: float = NO_WINDOW) -> None:
        """``patience`` is how many seconds without a window are an error while data come in."""
        self._patience = patience
        self._windows = self._received = 0
        self._waiting: float | None = None
        self._last = 0.0

    def rest(self, now: float) -> None:
        """Begin to wait for a window anew."""
        self._waiting, self._last = None, now

    def look(self, now: float, received: int, windows: int, silent: float) -> Verdict | None:
        """Judge the time since the last look; None where nothing is wrong.

        Args:
            now: The time.
            received: Messages that came in and are wanted, of all inputs.
            windows: Windows that were told of.
            silent: Seconds for which no input has sent anything; 0 while that is not long.
        """
        if windows != self._windows or silent:
            self._waiting = None
        elif received != self._received and self._waiting is None:
            self._waiting = self._last or now
        self._windows, self._received, self._last = windows, received, now
        if silent:
            return Verdict(Level.ERROR, f'no input at all for {silent:.1f} s')
        if self._waiting is not None and now - self._waiting >= self._patience:
            return Verdict(
                Level.ERROR, f'no window for {now - self._waiting:.0f} s while data come in'
            )
        return None


@dataclass(slots=True)
class Events:
    """Counts of what happens at a moment, each shown for a while."""

    _counts: dict[str, int] = field(default_factory=dict)
    _seen: dict[str, float] = field(default_factory=dict)

    def recent(self, now: float, counts: Mapping[str, int]) -> set[str]:
        """Which of the counts have grown within the last ``SHOWN`` seconds."""
        for key in grown(counts, self._counts):
            self._seen[key] = now
        self._counts = dict(counts)
        return {key for key, at in self._seen.items() if now - at < SHOWN}
