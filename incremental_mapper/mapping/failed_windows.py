"""Windows whose choice raised: told once, counted, and the first few kept for a report."""

import logging
import traceback
from collections import Counter
from collections.abc import Callable, Sequence

from incremental_mapper.frontend.front_end import Prepared
from incremental_mapper.measurements import Drops
from incremental_mapper.selection.window_record import WindowRecord

LOGGER = logging.getLogger('incremental_mapper')
MOST_RECORDS = 3
"""Failed windows whose inputs are kept for a report; the first ones are nearest to the cause."""
LARGEST_RECORD = 16_000_000
"""Bytes; a window of two VLP-16 takes about 0.2 MB."""


class FailedWindows:
    """What the windows that failed have cost.

    ``count`` is their number, ``drops`` what was not used because of them, and ``records`` are
    the inputs of the first ones.
    """

    def __init__(self) -> None:
        """None has failed yet."""
        self.count = 0
        self.drops: Drops = Counter()
        self.records: list[WindowRecord] = []

    def add(
        self,
        window: int,
        bounds: tuple[int, int],
        items: Sequence[Prepared],
        record: Callable[[str], WindowRecord],
    ) -> None:
        """Take in a window, while what it raised is being handled.

        Args:
            window: Its number.
            bounds: Its bounds, ns.
            items: Its core measurements, which are left out.
            record: Keeps what its choice depended on, with the traceback that it is given.
        """
        sensors = Counter(item.core.sensor for item in items)
        told = ', '.join(f'{count} of {name}' for name, count in sorted(sensors.items()))
        LOGGER.log(
            logging.DEBUG if self.count else logging.ERROR,
            'window %d, %d ns to %d ns, failed and is left out with its measurements (%s); '
            'further ones are only counted, as failed_windows',
            window,
            *bounds,
            told,
            exc_info=True,
        )
        self._keep(record)
        self.count += 1
        for name, count in sensors.items():
            self.drops[name, 'window_failed'] += count

    def _keep(self, record: Callable[[str], WindowRecord]) -> None:
        if len(self.records) >= MOST_RECORDS:
            return
        try:
            kept = record(traceback.format_exc())
        # What made the window fail may be in the way here too, and a report is worth less than
        # the map.
        except Exception:
            LOGGER.debug('the inputs of the failed window cannot be kept', exc_info=True)
            return
        if len(kept.data) <= LARGEST_RECORD:
            self.records.append(kept)
