"""What the node does where it broke on a real robot: a row for each trial, a file for each subject.

A row is a function of a scratch folder that really does the thing and returns what it saw:

    @row('received 28 of 60')
    def clouds(folder: Path) -> Seen:
        '''60 clouds of 0.77 MB at 10 Hz from a reliable publisher'''
        received = ...
        return Seen(f'received {received} of 60', received == 60)

The first line of its docstring says what was tried, its argument what was seen before. Files of
this package are found by themselves; ``robot.py`` runs the rows.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias


@dataclass(frozen=True, slots=True)
class Seen:
    """What was seen now, in words with figures, and whether that is as it should be."""

    now: str
    ok: bool


Trial: TypeAlias = Callable[[Path], Seen]


@dataclass(frozen=True, slots=True)
class Row:
    """One trial.

    Attributes:
        name: Subject (file) and function, as ``inputs.clouds``.
        tried: What is done, in one line.
        before: What was seen before.
        run: Does it below a folder.
        long: Whether it takes minutes.
    """

    name: str
    tried: str
    before: str
    run: Trial
    long: bool


ROWS: dict[str, Row] = {}


def row(before: str, *, long: bool = False) -> Callable[[Trial], Trial]:
    """Make a function a row.

    Args:
        before: What was seen before.
        long: Whether it takes minutes; it is then run with ``--long`` or by its name only.
    """

    def add(run: Trial) -> Trial:
        name = f'{run.__module__.rpartition(".")[2]}.{run.__name__}'
        ROWS[name] = Row(name, (run.__doc__ or '').splitlines()[0].rstrip('.'), before, run, long)
        return run

    return add


def all_rows() -> dict[str, Row]:
    """The rows of all files of this package, by name."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f'{__name__}.{module.name}')
    return dict(ROWS)
