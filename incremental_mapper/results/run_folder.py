"""Mapping one input into an output folder: what ``map`` does once and ``evaluate`` many times."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from incremental_mapper.config import Config, Tree, make_config
from incremental_mapper.datasets.open import open_source, read_truth
from incremental_mapper.datasets.source import Source
from incremental_mapper.results.candidate_table import FILE_NAME, MISSING, candidate_recorder
from incremental_mapper.results.offline_run import Run, Stop, map_source, settle_config
from incremental_mapper.results.run_files import write_result
from incremental_mapper.results.summary import draw_pictures
from incremental_mapper.trajectory import Trajectory


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """An opened input, its settled settings and its truth, if there is one."""

    source: Source
    config: Config
    truth: Trajectory | None


def open_drive(path: Path, tree: Tree, where: str, truth: Path | None = None) -> Drive:
    """Open an input with the user's settings ``tree``, whose origin ``where`` errors name.

    ``truth`` is a file that replaces the truth in the input. Raises MapperError where the input,
    the settings or the truth cannot be used.
    """
    make_config(tree, where)  # settings that are wrong by themselves are told before any reading
    source = open_source(path, tree)
    config = settle_config(source, tree, where)
    return Drive(source, config, source.truth() if truth is None else read_truth(truth))


def map_into(
    folder: Path,
    drive: Drive,
    progress: Callable[[int], Any] | None = None,
    stop: Stop | None = None,
) -> tuple[Run, list[str]]:
    """Map a drive and write all its files into an existing folder; returns remarks too.

    ``progress`` and ``stop`` are those of ``map_source``.
    """
    remarks = []
    with candidate_recorder(folder / FILE_NAME) as record:
        if record is None:
            remarks.append(MISSING)
        run = map_source(drive.source, drive.config, drive.truth, progress, stop, record)
    write_result(folder, run.result, run.points, run.stats)
    undrawn = draw_pictures(folder, run, drive.truth)
    return run, remarks if undrawn is None else [*remarks, undrawn]
