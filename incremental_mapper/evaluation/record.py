"""``evaluation.json``: what an evaluation ran and found; written, and read back by the report.

    format      1
    command     the command line that made it
    caption     what the user says of the drives; may be empty
    created     UTC time, ISO 8601
    status      'running', then 'finished'
    strategies  list of names, in the order of the table
    settings    the user's settings tree, without what the inputs bring themselves
    settings_from   the file that they came from, or 'settings'
    versions    of the package, its code, Python and the libraries
    rows        the table's rows: name, title, unit scale, decimals, whether higher is better
    remarks     lines that stand below the table
    sequences   list of: name; input (path); kind (of input, null where none could be opened);
                motion (of the paper's four, where the name begins with one, else null); label (the
                name without the motion); truth (path of its TUM file in the folder, or null);
                segments (list of motion, start_ns, end_ns) and segments_from ('truth', or the
                strategy whose estimate was cut, or null); segments only with --by-motion
    jobs        list, sequence by sequence, of: sequence; strategy; folder (path in the
                folder); status ('done', 'failed', or 'waiting' while it runs); error (one
                line, or null); reused (nothing had to be run); metrics (numbers of the drive
                by the names of ``rows``; null where there is none); by_motion (motion to such
                numbers; empty without --by-motion); findings (what was wrong, as in stats.json; a
                run with an error among them has its numbers, and they are not to be trusted);
                settings and versions (effective ones, from stats.json; null unless done)

Paths are relative to the folder of ``evaluation.json``, inputs absolute. Each job's folder holds
the files of a ``map`` run; ``truth.tum`` lies beside the folders of a sequence's strategies.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from incremental_mapper.config import Tree
from incremental_mapper.errors import InputError
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.jobs import Job, Outcome, Status
from incremental_mapper.evaluation.metrics import Metrics
from incremental_mapper.evaluation.segments import Motion, Segment, motion_of_name
from incremental_mapper.evaluation.table import BASE, ROWS, Entry
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory, read_tum

RECORD_FILE = 'evaluation.json'
FORMAT = 1
METHOD = 'mom'
"""The strategy that pictures and summaries speak of where it was run."""


@dataclass(frozen=True, slots=True)
class Found:
    """The numbers of one job; empty where it failed."""

    metrics: Metrics = field(default_factory=dict)
    by_motion: dict[Motion, Metrics] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Pieces:
    """A sequence cut by motion, and whose poses it was cut by."""

    segments: tuple[Segment, ...] = ()
    source: str | None = None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Everything that an evaluation ran and found; ``found`` goes with ``outcomes``."""

    out_dir: Path
    command: str
    caption: str
    strategies: tuple[str, ...]
    settings: Tree
    settings_from: str
    outcomes: tuple[Outcome, ...]
    found: tuple[Found, ...] = ()
    pieces: Mapping[str, Pieces] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def finished(self) -> bool:
        """Whether every job has come to an end."""
        return all(outcome.status is not Status.WAITING for outcome in self.outcomes)


def write_record(evaluation: Evaluation) -> Path:
    """Write ``evaluation.json``; returns its path.

    Raises:
        OSError: It cannot be written.
    """
    path = evaluation.out_dir / RECORD_FILE
    cache.write_json(path, _tree(evaluation))
    return path


def entries(evaluation: Evaluation, by_motion: bool) -> list[Entry]:
    """The table's entries, motion by motion in the paper's order.

    Args:
        evaluation: What was run and found.
        by_motion: Whether entries are the pieces of each motion, instead of whole drives.

    Returns:
        An entry for each job; a failed one has no numbers, and goes with each motion of its
        sequence.
    """
    made = []
    for outcome, found in zip(evaluation.outcomes, evaluation.found, strict=True):
        job = outcome.job
        if not by_motion:
            motion = motion_of_name(job.sequence)[0]
            made.append(Entry(job.sequence, motion, job.strategy, found.metrics, outcome.error))
            continue
        pieces = evaluation.pieces.get(job.sequence, Pieces())
        motions = [m for m in Motion if any(piece.motion is m for piece in pieces.segments)]
        choice: list[Motion | None] = [*motions] or [None]
        for motion in choice:
            metrics = {} if motion is None else found.by_motion.get(motion, {})
            made.append(Entry(job.sequence, motion, job.strategy, metrics, outcome.error))
    order = [*Motion, None]
    return sorted(made, key=lambda entry: order.index(entry.motion))


@dataclass(frozen=True)
class RecordedSequence:
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
            if job['status'] == Status.DONE
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
class RecordedEvaluation:
    """Everything of ``evaluation.json``: its tree, and its sequences with their runs."""

    record: Mapping[str, Any]
    sequences: tuple[RecordedSequence, ...]

    @property
    def strategies(self) -> tuple[str, ...]:
        """Names in the order of the table."""
        return tuple(self.record['strategies'])

    def entries(self) -> list[Entry]:
        """The table's entries, whole drives."""
        return [
            Entry(
                job['sequence'],
                _recorded_motion(sequence),
                job['strategy'],
                job['metrics'],
                job['error'],
            )
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


def read_record(out_dir: Path) -> RecordedEvaluation:
    """Read an evaluation back from its folder; files of its runs are read when they are asked for.

    Raises:
        InputError: The folder holds no evaluation.
    """
    path = out_dir / RECORD_FILE
    try:
        record = json.loads(path.read_text(encoding='utf-8'))
        names = [sequence['name'] for sequence in record['sequences']]
        jobs: dict[str, dict[str, Any]] = {name: {} for name in names}
        for job in record['jobs']:
            jobs[job['sequence']][job['strategy']] = job
        sequences = tuple(
            RecordedSequence(out_dir, sequence, jobs[sequence['name']])
            for sequence in record['sequences']
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{path}: is no record of "incremental_mapper evaluate" ({type(error).__name__}: '
            f'{error})'
        ) from error
    return RecordedEvaluation(record, sequences)


def _tree(evaluation: Evaluation) -> dict[str, Any]:
    found = evaluation.found or tuple(Found() for _ in evaluation.outcomes)
    done: dict[str, list[Outcome]] = {}
    for outcome in evaluation.outcomes:
        done.setdefault(outcome.job.sequence, []).append(outcome)
    return {
        'format': FORMAT,
        'command': evaluation.command,
        'caption': evaluation.caption,
        'created': datetime.now(UTC).isoformat(timespec='seconds'),
        'status': 'finished' if evaluation.finished else 'running',
        'strategies': list(evaluation.strategies),
        'settings': evaluation.settings,
        'settings_from': evaluation.settings_from,
        'versions': dict(cache.own_program()),
        'rows': [
            {
                'name': row.name,
                'title': row.title,
                'scale': row.scale,
                'decimals': row.decimals,
                'higher_is_better': row.higher,
            }
            for row in ROWS
        ],
        'remarks': list(evaluation.remarks),
        'sequences': [_sequence(evaluation, name, outcomes) for name, outcomes in done.items()],
        'jobs': [
            _job(evaluation.out_dir, outcome, numbers)
            for outcome, numbers in zip(evaluation.outcomes, found, strict=True)
        ],
    }


def _sequence(evaluation: Evaluation, name: str, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    motion, label = motion_of_name(name)
    pieces = evaluation.pieces.get(name, Pieces())
    finished = [outcome.job for outcome in outcomes if outcome.status is Status.DONE]
    truth = evaluation.out_dir / name / cache.TRUTH_FILE
    return {
        'name': name,
        'label': label,
        'input': str(outcomes[0].job.input),
        'kind': _stats(finished[0])['input']['kind'] if finished else None,
        'motion': motion,
        'truth': f'{name}/{cache.TRUTH_FILE}' if finished and truth.is_file() else None,
        'segments': [
            {'motion': piece.motion, 'start_ns': piece.start, 'end_ns': piece.end}
            for piece in pieces.segments
        ],
        'segments_from': pieces.source,
    }


def _job(out_dir: Path, outcome: Outcome, found: Found) -> dict[str, Any]:
    job = outcome.job
    stats: Mapping[str, Any] = _stats(job) if outcome.status is Status.DONE else {}
    return {
        'sequence': job.sequence,
        'strategy': job.strategy,
        'folder': job.folder.relative_to(out_dir).as_posix(),
        'status': outcome.status,
        'error': outcome.error,
        'reused': outcome.reused,
        'metrics': found.metrics,
        'by_motion': found.by_motion,
        'findings': stats.get('warnings', []),
        'settings': stats.get('settings'),
        'versions': stats.get('versions'),
    }


def _stats(job: Job) -> Mapping[str, Any]:
    return FinishedRun(job.folder).stats


def _recorded_motion(sequence: RecordedSequence) -> Motion | None:
    motion = sequence.record['motion']
    return None if motion is None else Motion(motion)
