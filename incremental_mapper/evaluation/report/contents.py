"""An evaluation read back from its folder (the layout is told in ``evaluation/record.py``)."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from incremental_mapper.errors import InputError
from incremental_mapper.evaluation.segments import Motion
from incremental_mapper.evaluation.table import BASE, Entry
from incremental_mapper.results.run_folder import FinishedRun
from incremental_mapper.trajectory import Trajectory, read_tum

RECORD_FILE = 'evaluation.json'
DONE = 'done'
METHOD = 'mom'


@dataclass(frozen=True)
class Sequence:
    """One input of the evaluation: its jobs by strategy, and its truth where it has one."""

    out_dir: Path
    record: Mapping[str, Any]
    jobs: Mapping[str, Mapping[str, Any]]

    @property
    def name(self) -> str:
        """What the evaluation calls it."""
        return str(self.record['name'])

    @cached_property
    def runs(self) -> dict[str, FinishedRun]:
        """Its finished runs by strategy, in the order of the table."""
        return {
            strategy: FinishedRun(self.out_dir / job['folder'])
            for strategy, job in self.jobs.items()
            if job['status'] == DONE
        }

    @property
    def lead(self) -> str | None:
        """The strategy that pictures show: the method if it is there, else not base if possible."""
        others = [name for name in self.runs if name != BASE]
        return METHOD if METHOD in self.runs else next(iter([*others, *self.runs]), None)

    @cached_property
    def truth(self) -> Trajectory | None:
        """The true trajectory."""
        path = self.record['truth']
        return None if path is None else read_tum(self.out_dir / path)


@dataclass(frozen=True, slots=True)
class Contents:
    """Everything of ``evaluation.json``."""

    record: Mapping[str, Any]
    sequences: tuple[Sequence, ...]

    @property
    def strategies(self) -> tuple[str, ...]:
        """Names in the order of the table."""
        return tuple(self.record['strategies'])

    def entries(self) -> list[Entry]:
        """The table's entries, whole drives."""
        return [
            Entry(job['sequence'], _motion(sequence), job['strategy'], job['metrics'], job['error'])
            for sequence in self.sequences
            for job in sequence.jobs.values()
        ]

    def motion_entries(self) -> list[Entry]:
        """The table's entries, pieces of drives by motion; none where drives were not cut."""
        return [
            Entry(job['sequence'], Motion(motion), job['strategy'], metrics, job['error'])
            for sequence in self.sequences
            for job in sequence.jobs.values()
            for motion, metrics in job['by_motion'].items()
        ]


def read_contents(out_dir: Path) -> Contents:
    """Read an evaluation's folder; raises InputError where it is none."""
    path = out_dir / RECORD_FILE
    try:
        record = json.loads(path.read_text(encoding='utf-8'))
        names = [sequence['name'] for sequence in record['sequences']]
        jobs: dict[str, dict[str, Any]] = {name: {} for name in names}
        for job in record['jobs']:
            jobs[job['sequence']][job['strategy']] = job
        sequences = tuple(
            Sequence(out_dir, sequence, jobs[sequence['name']]) for sequence in record['sequences']
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{path}: is no record of "incremental_mapper evaluate" ({type(error).__name__}: '
            f'{error})'
        ) from error
    return Contents(record, sequences)


def _motion(sequence: Sequence) -> Motion | None:
    motion = sequence.record['motion']
    return None if motion is None else Motion(motion)
