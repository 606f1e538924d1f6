"""Who watches a run beside the mapping: each window as it is closed, and the map at the end."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, TypeAlias

from incremental_mapper.config import Config
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult


class RunWatcher(Protocol):
    """Is told of a run; what goes wrong with it costs no map, and is told by ``trouble``."""

    @property
    def trouble(self) -> str:
        """What could not be done, one line; empty where all could."""
        ...

    def window(self, mapper: Mapper, result: WindowResult) -> None:
        """Take in a window.

        Args:
            mapper: The mapper, right after the window.
            result: What it gave back.
        """
        ...

    def finish(self, result: MapResult, cloud: MapCloud) -> None:
        """Take in the whole map, after the last window."""
        ...


Watch: TypeAlias = Callable[[Config], AbstractContextManager[RunWatcher]]
"""Begins to watch a run with these settings; where the block raises, nothing is left of it."""
