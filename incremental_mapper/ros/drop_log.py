"""What a log says of measurements that are left out: each reason once, then now and then."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from incremental_mapper.measurements import Drops
from incremental_mapper.ros.drop_reasons import DROP_REASONS, UNKNOWN
from incremental_mapper.ros.vitals import WANTED, grown

AGAIN = 60.0
"""Seconds between two lines on one sensor and reason."""


@dataclass(slots=True)
class _Said:
    at: float
    count: int


class DropLog:
    """Follows counts of what is left out, by sensor and reason; times are seconds, steady."""

    def __init__(self) -> None:
        self._said: dict[tuple[str, str], _Said] = {}
        self._counts: dict[tuple[str, str], int] = {}
        self._totals: Drops = Counter()

    def look(
        self,
        now: float,
        drops: Mapping[str, Mapping[str, int]],
        examples: Mapping[tuple[str, str], str],
    ) -> list[str]:
        """Lines that are due.

        Args:
            now: The time.
            drops: Counts by sensor and reason; they may begin anew.
            examples: What was said of the first one, where it is known.

        Returns:
            One line for each sensor and reason that is new, or that came again and was last
            spoken of ``AGAIN`` seconds ago.
        """
        counts = {
            (sensor, reason): count
            for sensor, reasons in drops.items()
            for reason, count in reasons.items()
            if reason not in WANTED
        }
        self._totals += grown(counts, self._counts)
        self._counts = counts
        lines = []
        for key, total in self._totals.items():
            said = self._said.get(key)
            if said is not None and (total == said.count or now - said.at < AGAIN):
                continue
            if said is None:
                lines.append(_first(key, total, examples.get(key, '')))
            else:
                sensor, reason = key
                more, passed = total - said.count, now - said.at
                lines.append(f'{sensor}: {more} more left out in {passed:.0f} s ({reason})')
            self._said[key] = _Said(now, total)
        return lines


def _first(key: tuple[str, str], count: int, example: str) -> str:
    sensor, reason = key
    known = DROP_REASONS.get(reason, UNKNOWN)
    remedy = f'; {known.remedy}' if known.remedy else ''
    first = f' (the first: {example})' if example else ''
    return f'{sensor}: {count} left out, {reason}: {known.meaning}{remedy}{first}'
