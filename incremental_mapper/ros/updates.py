"""What the worker tells the executor's thread."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import Config
from incremental_mapper.mapping.following import PoseUpdate
from incremental_mapper.mapping.live_map import GraphView, PathView
from incremental_mapper.mapping.newest_state import NewestState
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.ros.inbox import View


@dataclass(frozen=True, slots=True, eq=False)
class WindowUpdate:
    """A window's result.

    ``newest`` is None where the window appended nothing; ``points`` (N, 3) are its new points in
    the map, metres; ``stats`` the keys of stats.json so far; ``findings`` everything that was
    found wrong with this map so far. ``on_order`` ones were closed because somebody asked for it,
    or the map ends, and not by what came in: how long they waited says nothing.
    """

    result: WindowResult
    newest: NewestState | None
    points: NDArray[np.float64]
    stats: dict[str, Any]
    findings: tuple[Finding, ...]
    on_order: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ViewUpdate:
    """A view that was asked for, and the newest stamp in it (ns); the map is (N, 3), metres.

    ``seconds`` is how long it took to make.
    """

    view: View
    content: NDArray[np.float32] | PathView | GraphView
    stamp: int
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Reply:
    """What came of an order."""

    ticket: int
    success: bool
    message: str


@dataclass(frozen=True, slots=True)
class Restarted:
    """The map begins anew; what was published of the old one no longer holds.

    ``config`` are the settings from now on; ``findings`` are what they put right. There is no
    reason where the old one held nothing.
    """

    reason: str
    config: Config
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, slots=True)
class Retimed:
    """The stamps of sensors are put right from now on, and the map goes on.

    ``config`` are the settings from now on.
    """

    reason: str
    config: Config


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something that a log must tell of."""

    message: str


@dataclass(frozen=True, slots=True)
class News:
    """Something that a log may tell of."""

    message: str


Update: TypeAlias = (
    PoseUpdate | WindowUpdate | ViewUpdate | Reply | Restarted | Retimed | News | Trouble
)
