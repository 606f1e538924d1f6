"""Saving a map while the node runs: complete or not at all, and never over anything."""

import shutil
import tempfile
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.checks.finding import Finding
from incremental_mapper.errors import OutputError
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import Drops
from incremental_mapper.results.run_folder import draw_result, write_result
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics
from incremental_mapper.visualization.extras import left_out


@dataclass(frozen=True, slots=True)
class Saved:
    """The folder that was made, and a remark where there are no pictures in it.

    ``warnings`` are what was wrong with the map and its input, the worst first.
    """

    folder: Path
    note: str | None
    warnings: tuple[Finding, ...] = ()


def save_map(
    wanted: Path,
    mapper: Mapper,
    drops: Drops,
    wall: float,
    facts: InputFacts,
    findings: Iterable[Finding] = (),
) -> Saved:
    """Write the files of ``map`` while the mapper may go on afterwards.

    Args:
        wanted: the folder; where it exists, ``wanted_2`` and so on is made.
        mapper: what is saved.
        drops: what was lost before the mapper.
        wall: seconds since the first measurement.
        facts: what stats.json says of the input.
        findings: what was wrong with the input, before the mapper's own.

    Returns:
        The folder that was made, with what was wrong, and a remark where pictures are missing.

    Raises:
        OutputError: there is nothing to save, or the folder cannot be written.
    """
    result = mapper.result()
    if not result.clusters:
        raise OutputError('the map is empty, nothing was saved; no scan and no fix was mapped yet')
    points = result.points(mapper.config.map)
    target = wanted.expanduser().absolute()
    scratch: Path | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f'.{target.name}.', dir=target.parent))
        # mkdtemp makes folders that only their owner can read.
        scratch.chmod(0o755)
        statistics = RunStatistics.of_run(
            result, drops, wall, len(points), facts, findings=findings
        )
        write_result(scratch, result, points, statistics.to_tree())
        note = _draw(scratch, result, points)
        place = _free_name(target)
        scratch.rename(place)
        scratch = None
        return Saved(place, note, statistics.warnings)
    except OSError as error:
        raise OutputError(f'{target}: cannot be written ({error.strerror or error})') from error
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


def _draw(folder: Path, result: MapResult, points: NDArray[np.float32]) -> str | None:
    """Draw the pictures; returns a remark where they cannot be drawn."""
    try:
        draw_result(folder, result, points, None)
    # The drawing library may raise anything, and a map is worth saving without pictures.
    except Exception:
        return f'no pictures:\n{traceback.format_exc()}'
    return left_out(['pictures'])


def _free_name(target: Path) -> Path:
    numbers = count(2)
    place = target
    while place.exists() or place.is_symlink():
        place = target.with_name(f'{target.name}_{next(numbers)}')
    return place
