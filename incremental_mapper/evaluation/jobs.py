"""The jobs of an evaluation: one input under one strategy each, in a folder of its own."""

import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from incremental_mapper.config import Tree
from incremental_mapper.errors import MapperError, OutputError
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.workers import stop_of_this_process
from incremental_mapper.results.offline_run import map_into
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.run_folder import prepared_folder
from incremental_mapper.selection.strategies import labelled
from incremental_mapper.settings import merge
from incremental_mapper.trajectory import Trajectory, write_tum

FAILURE_FILE = 'failure.txt'


class Status(StrEnum):
    """How far a job has come."""

    WAITING = 'waiting'
    DONE = 'done'
    FAILED = 'failed'
    INTERRUPTED = 'interrupted'


@dataclass(frozen=True, slots=True)
class Job:
    """One input under one strategy; everything that a worker on another machine needs.

    ``folder`` is the absolute output folder, ``tree`` the settings, strategy included, ``where``
    their origin for messages, ``key`` what the cache knows the run by and ``program`` the versions
    that the worker must have.
    """

    sequence: str
    strategy: str
    input: Path
    truth: Path | None
    folder: Path
    tree: Tree
    where: str
    key: str
    program: dict[str, str]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a job; ``error`` is one line, ``reused`` tells that nothing was run."""

    job: Job
    status: Status
    error: str | None = None
    reused: bool = False


def plan_jobs(
    inputs: Sequence[Path],
    out_dir: Path,
    strategies: Sequence[str],
    tree: Tree,
    where: str,
    truth: Path | None = None,
) -> list[Job]:
    """All jobs, input by input.

    Args:
        inputs: What is to be mapped; what is given twice is taken once.
        out_dir: The folder of the evaluation.
        strategies: Labels, see ``strategies.labelled``, in the order of the table.
        tree: The user's settings.
        where: Where they come from, for messages.
        truth: A file of true poses that replaces the truth in every input.
    """
    paths = list(dict.fromkeys(path.resolve() for path in inputs))
    jobs = []
    own_truth = None if truth is None else truth.resolve()
    for path, name in zip(paths, sequence_names(paths), strict=True):
        prints = [cache.input_fingerprint(path), cache.file_fingerprint(own_truth)]
        for strategy in strategies:
            known, own = labelled(strategy)
            settings, program = merge(tree, own), cache.program(known)
            key = cache.digest([*prints, settings, program])
            folder = out_dir.resolve() / name / strategy
            jobs.append(Job(name, strategy, path, own_truth, folder, settings, where, key, program))
    return jobs


def sequence_names(paths: Sequence[Path]) -> list[str]:
    """A short name for every input: its own, with the names of folders above where two agree.

    Args:
        paths: Absolute paths that differ.

    Returns:
        Names without a slash that differ, in the order of the paths.
    """
    names = [path.stem if path.is_file() else path.name for path in paths]
    depth = 1
    while len(set(names)) < len(names):
        doubled = {name for name in names if names.count(name) > 1}
        longer = ['_'.join(path.parts[1:][-depth:]) for path in paths]
        names = [new if old in doubled else old for old, new in zip(names, longer, strict=True)]
        depth += 1
        if depth > max(len(path.parts) for path in paths) + 1:
            # a_b/c and a/b_c, say: their numbers tell them apart.
            names = [f'{name}_{number}' for number, name in enumerate(names, start=1)]
    return [name or 'input' for name in names]


def run_job(job: Job) -> Outcome:
    """Map one input in this process; whatever goes wrong becomes a failed outcome."""
    try:
        return _run(job)
    except KeyboardInterrupt:
        return Outcome(job, Status.INTERRUPTED)
    except MapperError as error:
        return Outcome(job, Status.FAILED, str(error))
    except Exception as error:
        return Outcome(job, Status.FAILED, _unexpected(job, error))


def _run(job: Job) -> Outcome:
    own = cache.program(labelled(job.strategy)[0])
    different = sorted(name for name, value in own.items() if job.program.get(name) != value)
    if different:
        name = different[0]
        raise MapperError(
            f'this worker has {name} {own[name]}, the evaluation was started with '
            f'{job.program.get(name)}; install the same versions'
        )
    try:
        with prepared_folder(job.folder, force=True):
            cache.clear(job.folder)
            (job.folder / FAILURE_FILE).unlink(missing_ok=True)
            drive = open_drive(job.input, job.tree, job.where, job.truth)
            run = map_into(job.folder, drive, stop=stop_of_this_process())
            if run.statistics.interrupted:
                return Outcome(job, Status.INTERRUPTED)
            _write_truth(job.folder.parent / cache.TRUTH_FILE, job.strategy, drive.truth)
            made_of = {'input': str(job.input), 'settings': job.tree, 'program': job.program}
            cache.mark_finished(job.folder, job.key, drive.truth is not None, made_of)
    except OSError as error:
        raise OutputError(f'{job.folder}: cannot be written ({error.strerror})') from error
    return Outcome(job, Status.DONE)


def _write_truth(path: Path, strategy: str, truth: Trajectory | None) -> None:
    """All strategies of a sequence write the same file, so it does not matter who is last."""
    if truth is None:
        path.unlink(missing_ok=True)
        return
    partial = path.with_name(f'.{path.name}.{strategy}.partial')
    write_tum(partial, truth)
    partial.replace(path)


def _unexpected(job: Job, error: Exception) -> str:
    reason = ' '.join(str(error).split())
    message = f'unexpected {type(error).__name__}: {reason}'
    try:
        path = job.folder / FAILURE_FILE
        path.write_text(''.join(traceback.format_exception(error)), encoding='utf-8')
    except OSError:
        return message
    return f'{message}; see {path}'
