"""How much may be spent on a window while measurements come faster than they are mapped."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Effort:
    """Limits for the next windows.

    Of the connected candidates at most ``candidates`` are solved, the least shifted ones; None
    solves all. ``windows`` closed windows are merged into one.
    """

    candidates: int | None = None
    windows: int = 1


FULL = Effort()
"""No limits: what an offline run spends."""
