"""How much may be spent on a window while measurements come faster than they are mapped."""

from dataclasses import dataclass

MOST_BYTES = 128 << 20
"""60 windows of two VLP-16 take half of it. With 128 beams 60 windows took 0.8 GB; 20 scans are as
many as keep a LiDAR's process busy while a window takes long."""


@dataclass(frozen=True, slots=True)
class LoadShedding:
    """Limits for the next windows.

    Of the connected candidates at most ``candidates`` are solved, the least shifted ones; None
    solves all. ``windows`` closed windows are merged into one. While an older window's scans are
    prepared in other processes, so many more may be prepared behind it, ``read_ahead``, as long as
    their scans take no more than ``most_bytes``.
    """

    candidates: int | None = None
    windows: int = 1
    read_ahead: int = 5
    most_bytes: int = MOST_BYTES


NO_SHEDDING = LoadShedding()
"""No limits: what is spent on a window in time."""
READ_AHEAD = LoadShedding(read_ahead=60)
"""No limits, and where nobody waits for a window: goes on reading while the processes start."""
