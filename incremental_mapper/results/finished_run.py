"""A finished run read back from its folder, and instants of it as users name them."""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.candidate_table import FILE_NAME, read_window
from incremental_mapper.trajectory import Trajectory, read_tum

Record: TypeAlias = Mapping[str, Any]

GRAPH_SECONDS = 1.5
"""Length of the stretch of graph that is drawn unless another is asked for: more is a blur."""
ABSOLUTE_SECONDS = Decimal(10) ** 8
ABSOLUTE_NANOSECONDS = Decimal(10) ** 15
"""Numbers from here on are stamps: the first three years of a clock are no time of a drive."""


@dataclass(frozen=True)
class FinishedRun:
    """The output folder of ``map``; its files are read when they are asked for.

    Every attribute raises InputError where its file is missing or is not what ``map`` writes.
    """

    folder: Path

    @cached_property
    def stats(self) -> Record:
        """The keys of stats.json."""
        return self._json('stats.json', 'strategy')

    @cached_property
    def graph(self) -> Record:
        """The layout of graph.json."""
        return self._json('graph.json', 'clusters')

    @cached_property
    def windows(self) -> Sequence[Mapping[str, str]]:
        """The rows of windows.csv."""
        path = self._path('windows.csv')
        with path.open(encoding='utf-8', newline='') as file:
            rows = list(csv.DictReader(file))
        if rows and 'start_ns' not in rows[0]:
            raise InputError(f'{path}: is no table of windows')
        return rows

    @cached_property
    def trajectory(self) -> Trajectory:
        """T_map_base at every cluster stamp."""
        return read_tum(self._path('trajectory.tum'))

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The map (N, 3) in metres."""
        return _read_points(self._path('map.ply'))

    @cached_property
    def fixes(self) -> NDArray[np.float64]:
        """Antenna positions (K, 3) that the graph holds, metres in the map."""
        found = [item['position'] for item in self.graph['factors'] if item['kind'] == 'gnss']
        return np.array(found, dtype=np.float64).reshape(-1, 3)

    @cached_property
    def first_stamp(self) -> int:
        """Stamp of the first cluster in nanoseconds: second 0 of every picture."""
        return int(min(item['stamp_ns'] for item in self.graph['clusters']))

    @cached_property
    def last_stamp(self) -> int:
        """Stamp of the last cluster in nanoseconds."""
        return int(max(item['stamp_ns'] for item in self.graph['clusters']))

    def check(self) -> None:
        """Raise InputError where the folder is no output of ``map``."""
        self._path('stats.json')

    def candidates(self, window: int) -> list[dict[str, Any]]:
        """The rows of one window in candidates.parquet."""
        return read_window(self._path('stats.json').with_name(FILE_NAME), window)

    def stamp(self, text: str) -> int:
        """The stamp in nanoseconds that a user's number means.

        Seconds since the first cluster, or from 1e8 on a stamp in seconds, from 1e15 on in
        nanoseconds. Raises ConfigError where it is no number.
        """
        try:
            number = Decimal(text)
            if number >= ABSOLUTE_NANOSECONDS:
                return int(number)
            stamp = round(number * NANOSECONDS)
        except (InvalidOperation, ValueError, OverflowError) as error:
            raise ConfigError(
                f'{text!r} is no time; expected seconds since the first cluster, or a stamp'
            ) from error
        return stamp if number >= ABSOLUTE_SECONDS else self.first_stamp + stamp

    def seconds(self, stamp: int) -> float:
        """Seconds from the first cluster to a stamp."""
        return (stamp - self.first_stamp) / NANOSECONDS

    def stretch(self, seconds: float = GRAPH_SECONDS) -> tuple[int, int]:
        """Start and end of a stretch worth drawing; see ``interesting_stretch``."""
        return interesting_stretch(self.graph, seconds)

    def _json(self, name: str, key: str) -> Record:
        path = self._path(name)
        try:
            tree = json.loads(path.read_text(encoding='utf-8'))
        except (OSError, ValueError) as error:
            raise InputError(f'{path}: cannot be read ({error})') from error
        if not isinstance(tree, dict) or key not in tree:
            raise InputError(f'{path}: is not what "incremental_mapper map" writes')
        return tree

    def _path(self, name: str) -> Path:
        path = self.folder / name
        if not path.is_file():
            what = 'no such folder' if not self.folder.is_dir() else f'{name} is missing'
            raise InputError(f'{self.folder}: is no output of "incremental_mapper map" ({what})')
        return path


def interesting_stretch(graph: Record, seconds: float) -> tuple[int, int]:
    """Start and end (ns) around a fix in the middle of the drive: all kinds of factors are in it.

    ``graph`` has the layout of graph.json and at least one cluster.
    """
    stamps = [item['stamp_ns'] for item in graph['clusters']]
    fixes = [
        member['stamp_ns']
        for item in graph['clusters']
        for member in item['members']
        if member['kind'] == 'gnss'
    ]
    first, last, length = min(stamps), max(stamps), round(seconds * NANOSECONDS)
    middle = (first + last) // 2
    centre = min(fixes, key=lambda stamp: abs(stamp - middle), default=middle)
    start = max(min(centre - length // 2, last - length), first)
    return start, start + length


def _read_points(path: Path) -> NDArray[np.float64]:
    """Points (N, 3) of a map that ``map`` wrote.

    Its layout is fixed; small_gicp's reader ends the process where a file is damaged.
    """
    head, end, body = path.read_bytes().partition(b'end_header\n')
    count = re.search(rb'^element vertex (\d+)$', head, flags=re.MULTILINE)
    if not end or count is None or len(body) != 12 * int(count[1]):
        raise InputError(f'{path}: is damaged, or is no map that "incremental_mapper map" wrote')
    return np.frombuffer(body, dtype='<f4').reshape(-1, 3).astype(np.float64)
