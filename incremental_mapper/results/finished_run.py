"""The folder of a run that has ended, read back."""

import csv
import json
import logging
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import ConfigError, InputError
from incremental_mapper.map.ply import MapFile
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.candidate_table import FILE_NAME, read_window
from incremental_mapper.results.file_names import (
    GRAPH,
    JOURNAL,
    MAP,
    STATISTICS,
    TRAJECTORY,
    WINDOWS,
)
from incremental_mapper.results.manifest import FILE as MANIFEST
from incremental_mapper.results.manifest import FORMAT, Manifest
from incremental_mapper.trajectory import Trajectory, read_tum
from incremental_mapper.visualization.graph_view import GRAPH_SECONDS, typical_stretch

LOGGER = logging.getLogger('incremental_mapper')
Record: TypeAlias = Mapping[str, Any]

LATEST = Decimal(2**63)
"""Stamps in nanoseconds have 64 bits."""
ABSOLUTE_SECONDS = Decimal(10) ** 8
ABSOLUTE_NANOSECONDS = Decimal(10) ** 15
"""Numbers from here on are stamps: the first three years of a clock are no time of a drive."""


@dataclass(frozen=True)
class FinishedRun:
    """The folder of a run that has ended; its files are read when they are asked for.

    Every attribute raises InputError where its file is missing or is not what ``map`` writes. One
    that has changed since it was written is used all the same, and the log says so.
    """

    folder: Path

    @cached_property
    def stats(self) -> Record:
        """The keys of stats.json."""
        return self._json(STATISTICS, {'strategy'})

    @cached_property
    def graph(self) -> Record:
        """The layout of graph.json, see ``graph_json.graph_tree``."""
        return self._json(GRAPH, {'clusters', 'variables', 'factors'})

    @cached_property
    def windows(self) -> Sequence[Mapping[str, str]]:
        """The rows of windows.csv."""
        path = self._path(WINDOWS)
        with path.open(encoding='utf-8', newline='') as file:
            rows = list(csv.DictReader(file))
        if rows and 'start_ns' not in rows[0]:
            raise InputError(f'{path}: is no table of windows')
        return rows

    @cached_property
    def trajectory(self) -> Trajectory:
        """T_map_base at every cluster stamp."""
        return read_tum(self._path(TRAJECTORY))

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """The map (N, 3) in metres."""
        return self.map.columns(('x', 'y', 'z'), np.float64)

    @property
    def intensities(self) -> NDArray[np.float32] | None:
        """Intensities (N,) of ``points``; None where no LiDAR measured them."""
        if 'intensity' not in (self.map.dtype.names or ()):
            return None
        return self.map.columns(('intensity',), np.float32)[:, 0]

    @cached_property
    def map(self) -> MapFile:
        """The map, whose points are read when they are asked for."""
        return MapFile(self._path(MAP))

    @property
    def georeferenced(self) -> bool:
        """Whether x is east and y north."""
        return bool(self.stats.get('georeferenced', False))

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
        self._path(STATISTICS)

    def candidates(self, window: int) -> list[dict[str, Any]]:
        """The candidates of one window, from ``candidates.parquet``.

        Args:
            window: Number of the window, from 0.

        Returns:
            One dictionary a candidate; the columns are told in ``candidate_table``.
        """
        return read_window(self._path(STATISTICS).with_name(FILE_NAME), window)

    def stamp(self, text: str) -> int:
        """The stamp in nanoseconds that a user's number means.

        Args:
            text: Seconds since the first cluster, or from 1e8 on a stamp in seconds, from 1e15
                on in nanoseconds.

        Returns:
            The stamp, ns.

        Raises:
            ConfigError: It is no number.
        """
        try:
            number = Decimal(text)
            # A number like 1e99999999 would be written out digit by digit.
            if not number.copy_abs() < LATEST:
                raise ValueError
            if number >= ABSOLUTE_NANOSECONDS:
                return round(number)
            stamp = round(number * NANOSECONDS)
        except (InvalidOperation, ValueError, OverflowError) as error:
            raise ConfigError(
                f'{text!r} is no time; expected seconds since the first cluster, or a stamp'
            ) from error
        return stamp if number >= ABSOLUTE_SECONDS else self.first_stamp + stamp

    def seconds(self, stamp: int) -> float:
        """Time of a stamp as pictures show it.

        Args:
            stamp: Any stamp, ns.

        Returns:
            Seconds from the first cluster to it.
        """
        return (stamp - self.first_stamp) / NANOSECONDS

    def stretch(self, seconds: float = GRAPH_SECONDS) -> tuple[int, int]:
        """A stretch worth drawing; see ``interesting_stretch``.

        Args:
            seconds: How long it is to be.

        Returns:
            Its start and end, ns.
        """
        return typical_stretch(self.graph, seconds)

    def _json(self, name: str, keys: set[str]) -> Record:
        path = self._path(name)
        try:
            tree = json.loads(path.read_text(encoding='utf-8'))
        except (OSError, ValueError) as error:
            raise InputError(f'{path}: cannot be read ({error})') from error
        if not isinstance(tree, dict) or not keys <= tree.keys():
            raise InputError(f'{path}: is not what "incremental_mapper map" writes')
        return tree

    def _path(self, name: str) -> Path:
        path = self.folder / name
        if not path.is_file():
            what = 'no such folder' if not self.folder.is_dir() else f'{name} is missing'
            if any(self.folder.glob(f'*{JOURNAL}')):
                command = f'incremental_mapper recover {shlex.quote(str(self.folder))}'
                raise InputError(
                    f'{self.folder}: holds journals of maps that were cut off and no map; '
                    f'"{command}" makes maps of them'
                )
            raise InputError(f'{self.folder}: is no output of "incremental_mapper map" ({what})')
        if name not in self._looked_at:
            self._looked_at.add(name)
            self._look_at(name)
        return path

    @cached_property
    def _looked_at(self) -> set[str]:
        return set()

    @cached_property
    def _manifest(self) -> Manifest | None:
        try:
            manifest = Manifest.read(self.folder)
        except InputError as error:
            LOGGER.warning('%s', error)
            return None
        if manifest is not None and manifest.format != FORMAT:
            LOGGER.warning(
                '%s: has format %d, this version reads %d: it may be misunderstood',
                self.folder,
                manifest.format,
                FORMAT,
            )
        return manifest

    def _look_at(self, name: str) -> None:
        """Say where a file is not as it was written."""
        if self._manifest is not None and not self._manifest.sound(self.folder, name):
            LOGGER.warning(
                '%s: damaged or changed since it was written (its checksum is not that of %s)',
                self.folder / name,
                MANIFEST,
            )
