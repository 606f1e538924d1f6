"""A window: what is mapped in one step."""

from collections.abc import Sequence
from dataclasses import dataclass

from incremental_mapper.measurements import CoreInput, ImuSample, LidarScan


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Measurements with start <= stamp < end (ns), each kind in time order.

    Core measurements may be older than ``start`` where they came late but still fit.
    """

    start: int
    end: int
    core: tuple[CoreInput, ...]
    imu: tuple[ImuSample, ...]

    @property
    def nbytes(self) -> int:
        """Memory that its scans take."""
        return sum(item.nbytes for item in self.core if isinstance(item, LidarScan))


def joined(windows: Sequence[Window]) -> Window:
    """Consecutive windows, at least one, as one."""
    return Window(
        start=windows[0].start,
        end=windows[-1].end,
        core=tuple(item for window in windows for item in window.core),
        imu=tuple(item for window in windows for item in window.imu),
    )
