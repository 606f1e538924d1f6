"""A drive that is ready to be mapped: its opened input, and the settings that it is mapped with."""

import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from incremental_mapper.checks.finding import Finding
from incremental_mapper.config import Config, Tree
from incremental_mapper.datasets.open import open_source, read_truth
from incremental_mapper.datasets.source import Source
from incremental_mapper.results.sessions.going_on import EarlierMap, earlier_map
from incremental_mapper.results.survey import BRIEF, survey
from incremental_mapper.settings import make_config, merge
from incremental_mapper.trajectory import Trajectory

UNRELATED = {'selection', 'save', 'journal', 'session', 'datum'}
"""Sections of settings that say nothing of the sensors: with these alone a look still chooses."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """An opened input, its effective settings and its truth, if there is one.

    ``tree`` are the user's settings and what was mended since, ``where`` is where they come from.
    ``mended`` is what the data have proved wrong so far, and ``config`` puts right. ``notes`` are
    remarks on the settings. ``earlier`` is the map that it goes on with, if any.
    """

    source: Source
    config: Config
    truth: Trajectory | None
    tree: Tree
    where: str
    mended: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    earlier: EarlierMap | None = None

    def all_notes(self) -> tuple[str, ...]:
        """Remarks on how the input was understood, and on the settings it is mapped with."""
        return (*self.source.info.notes, *self.notes)


def open_drive(path: Path, tree: Tree, where: str, truth: Path | None = None) -> Drive:
    """Open an input with the user's settings; without any, a look at it chooses them.

    Args:
        path: KAIST folder, bag, or folder of scans.
        tree: The user's settings; they are laid over those that the input brings itself.
        where: Where the settings come from, for messages.
        truth: A file of true poses that replaces the truth in the input.

    Raises:
        MapperError: The input, the settings or the truth cannot be used.
    """
    # Settings that are wrong by themselves are told before any reading.
    given = make_config(tree, where)
    earlier = earlier_map(given)
    if earlier is not None:
        tree = merge(tree, earlier.settings)
    source = open_source(path, tree)
    config = effective_config(source, tree, where)
    known = source.truth() if truth is None else read_truth(truth)
    drive = Drive(source, config, known, tree, where, earlier=earlier)
    return drive if tree.keys() - UNRELATED else _looked_at(drive)


def _looked_at(drive: Drive) -> Drive:
    """A drive without settings, with those that a look at it proposes."""
    seen = survey(drive.source, drive.config, BRIEF, match=False)
    proposed = seen.settings()
    if not proposed:
        return drive
    tree = merge(proposed, drive.tree)
    # What changes how sensors are read counts from the opening on.
    reopen = bool(proposed.keys() & {'lidars', 'imu', 'gnss'})
    source = open_source(drive.source.info.path, tree) if reopen else drive.source
    config = effective_config(source, tree, drive.where)
    said = ', '.join(choice.text for choice in seen.start)
    files = ' and '.join(dict.fromkeys(choice.file for choice in seen.start))
    note = (
        f'no settings are given; a look at the sensors chose {said}, as in {files} '
        f'("incremental_mapper check {shlex.quote(str(drive.source.info.path))}" says why)'
    )
    notes = (note,) if seen.start else ()
    return replace(
        drive, source=source, config=config, tree=tree, mended=seen.mended(), notes=notes
    )


def effective_config(source: Source, tree: Mapping[str, Any], where: str) -> Config:
    """The settings of a run: the user's laid over those that the input brings itself.

    Args:
        source: An opened input.
        tree: The user's settings.
        where: Where they come from, for messages.

    Raises:
        ConfigError: A setting is unknown or has a value that it cannot have.
    """
    return make_config(merge(source.info.settings, tree), where)
