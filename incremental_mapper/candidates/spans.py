"""Which IMU samples lie between two cluster stamps."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.candidates.model import SpanBias


@dataclass(frozen=True, slots=True, eq=False)
class ImuStamps:
    """Sorted stamps (K,) int64 of the window's unused IMU samples.

    A span with a hole longer than ``max_gap`` nanoseconds makes no connection: the motion inside
    the hole is unknown. ``bias`` says which bias the spans have.
    """

    stamps: NDArray[np.int64]
    max_gap: int
    bias: SpanBias = SpanBias.EACH_END
    # Candidates ask for the same few spans again and again.
    _asked: dict[tuple[int, int], int | None] = field(default_factory=dict, init=False, repr=False)

    def bounds(self, start: int, end: int) -> tuple[int, int]:
        """Positions [low, high) of the samples with start <= stamp < end."""
        low, high = self.stamps.searchsorted((start, end)).tolist()
        return low, high

    def first_sample(self, start: int, end: int) -> int | None:
        """First sample of the span between two stamps.

        Args:
            start: Where the span begins, ns.
            end: Where it ends, ns.

        Returns:
            Its stamp, ns; None where no connection can be made: there is no sample with
            start <= stamp < end, or a hole longer than ``max_gap``.
        """
        if (start, end) not in self._asked:
            self._asked[start, end] = self._first_sample(start, end)
        return self._asked[start, end]

    def _first_sample(self, start: int, end: int) -> int | None:
        low, high = self.bounds(start, end)
        if high <= low:
            return None
        inside: list[int] = self.stamps[low:high].tolist()
        # On plain integers, since a span has a few samples.
        gap = max(second - first for first, second in pairwise([start, *inside, end]))
        return inside[0] if gap <= self.max_gap else None
