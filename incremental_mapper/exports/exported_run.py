"""What a format is given: a run's map, trajectory and graph, and where on Earth they lie."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from incremental_mapper.errors import InputError
from incremental_mapper.exports.place import Place
from incremental_mapper.map.ply import MapFile
from incremental_mapper.trajectory import Trajectory


class ExportedRun(Protocol):
    """A finished run; what is not asked for is not read. ``FinishedRun`` is one."""

    @property
    def folder(self) -> Path:
        """Where its files are."""

    @property
    def map(self) -> MapFile:
        """Its points, in pieces."""

    @property
    def trajectory(self) -> Trajectory:
        """T_map_base at every cluster stamp."""

    @property
    def graph(self) -> Mapping[str, Any]:
        """The layout of ``graph.json``."""

    @property
    def stats(self) -> Mapping[str, Any]:
        """The keys of ``stats.json``."""


def maker(run: ExportedRun) -> str:
    """What files say they were made by: this program, in the version that mapped.

    Args:
        run: Any run.
    """
    version = run.stats.get('versions', {}).get('incremental_mapper', '')
    return f'incremental_mapper {version}'.strip()


def place_of(run: ExportedRun) -> Place | None:
    """Where the map lies on Earth.

    Args:
        run: Any run.

    Returns:
        The place; None where the map is not georeferenced.
    """
    datum = run.stats.get('datum')
    if not run.stats.get('georeferenced') or not datum:
        return None
    return Place(*map(float, datum))


def known_place(run: ExportedRun) -> Place:
    """As ``place_of``, for formats that say nothing without it.

    Raises:
        InputError: The map is not georeferenced.
    """
    place = place_of(run)
    if place is None:
        raise InputError(
            f'{run.folder}: the map is not georeferenced, so it has no place on Earth; '
            'take a format in metres, such as tum, csv or ply'
        )
    return place
