"""An evaluation: every strategy on every input, and what the runs say beside each other."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from incremental_mapper.checks.finding import Severity
from incremental_mapper.config import Tree
from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.errors import OutputError
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.jobs import Job, Outcome, Status, run_job
from incremental_mapper.evaluation.map_quality import QualityJob, run_quality_job, stored_quality
from incremental_mapper.evaluation.metrics import drive_metrics, motion_metrics, unmended
from incremental_mapper.evaluation.record import (
    RECORD_FILE,
    Evaluation,
    Found,
    Pieces,
    write_record,
)
from incremental_mapper.evaluation.segments import Motion, segment_by_motion
from incremental_mapper.evaluation.table import BASE, motion_title
from incremental_mapper.evaluation.workers import Workers
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory

CUT_BY = ('mom', BASE)
"""Strategies whose estimate tells the motion of a drive without truth, the best one first."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be evaluated: the jobs, and what ``evaluation.json`` tells of the call."""

    out_dir: Path
    jobs: tuple[Job, ...]
    strategies: tuple[str, ...]
    settings: Tree
    settings_from: str
    command: str
    caption: str
    by_motion: bool


def prepare_out_dir(folder: Path, inputs: Sequence[Path], force: bool) -> None:
    """Make the folder, or take that of an earlier evaluation.

    Args:
        folder: The folder.
        inputs: What is to be mapped; the folder must not lie in one of them.
        force: Take it although it holds something else.

    Raises:
        OutputError: It cannot be made, or must not be taken.
    """
    for path in inputs:
        if path.is_dir() and folder.resolve().is_relative_to(path.resolve()):
            raise OutputError(f'{folder}: lies in the input {path}; name a folder outside of it')
    try:
        if folder.exists() and not folder.is_dir():
            raise OutputError(f'{folder}: is a file, expected a folder for the output')
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / RECORD_FILE).is_file() and any(folder.iterdir()) and not force:
            raise OutputError(
                f'{folder}: is not empty and holds no evaluation; name another folder or '
                'add --force'
            )
    except OSError as error:
        raise OutputError(f'{folder}: cannot be made ({error.strerror})') from error


def unfinished(jobs: Sequence[Job]) -> list[Job]:
    """The jobs that have to be run."""
    return [job for job in jobs if not cache.is_finished(job.folder, job.key)]


def evaluate(
    plan: Plan, todo: Sequence[Job], workers: Workers, tell: Callable[[Outcome], object]
) -> Evaluation:
    """Run what is left of a plan, compare all of its runs and write ``evaluation.json``.

    Args:
        plan: All jobs.
        todo: Those that have to be run, see ``unfinished``.
        workers: Whoever runs them.
        tell: Called with the outcome of each job that was run.

    Returns:
        What was run and found; a job that failed is told there.

    Raises:
        KeyboardInterrupt: It was interrupted; what is done until then is not run again.
        InputError: A file of a finished run cannot be read.
    """
    evaluation = Evaluation(
        out_dir=plan.out_dir.resolve(),
        command=plan.command,
        caption=plan.caption,
        strategies=plan.strategies,
        settings=plan.settings,
        settings_from=plan.settings_from,
        outcomes=_before(plan.jobs, todo),
    )
    write_record(evaluation)
    evaluation = replace(evaluation, outcomes=_run(evaluation.outcomes, todo, workers, tell))
    qualities, remarks = _qualities(evaluation, workers)
    pieces = _cut(evaluation) if plan.by_motion else {}
    evaluation = replace(
        evaluation,
        found=_found(evaluation, qualities, pieces),
        pieces=pieces,
        remarks=(*_remarks(evaluation, pieces), *remarks),
    )
    write_record(evaluation)
    return evaluation


def _before(jobs: Sequence[Job], todo: Sequence[Job]) -> tuple[Outcome, ...]:
    """What is known before anything has been run."""
    waiting = {job.folder for job in todo}
    return tuple(
        Outcome(job, Status.WAITING)
        if job.folder in waiting
        else Outcome(job, Status.DONE, reused=True)
        for job in jobs
    )


def _run(
    before: Sequence[Outcome],
    todo: Sequence[Job],
    workers: Workers,
    tell: Callable[[Outcome], object],
) -> tuple[Outcome, ...]:
    """The outcomes of all jobs, in their order, after those that were left have been run."""
    outcomes = {outcome.job.folder: outcome for outcome in before}
    for job, future in workers.run(run_job, todo):
        outcome = _outcome(job, future)
        if outcome.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        outcomes[job.folder] = outcome
        tell(outcome)
    return tuple(outcomes.values())


def _outcome(job: Job, future: 'Future[Outcome]') -> Outcome:
    """What a completed future says; a worker that died says it by an exception."""
    if future.cancelled():
        return Outcome(job, Status.FAILED, 'the cluster gave the job up')
    error = future.exception()
    if isinstance(error, BrokenProcessPool):
        return Outcome(job, Status.FAILED, 'its process died; is there enough memory for --jobs?')
    if error is not None:
        reason = ' '.join(str(error).split())
        return Outcome(job, Status.FAILED, f'the worker failed: {type(error).__name__} {reason}')
    return future.result()


def _finished(evaluation: Evaluation) -> list[Outcome]:
    return [outcome for outcome in evaluation.outcomes if outcome.status is Status.DONE]


def _found(
    evaluation: Evaluation,
    qualities: Mapping[Path, Mapping[str, float | None]],
    pieces: Mapping[str, Pieces],
) -> tuple[Found, ...]:
    """The numbers of every job, read from its folder; those of a failed job are missing."""
    bases = {
        outcome.job.sequence: FinishedRun(outcome.job.folder)
        for outcome in _finished(evaluation)
        if outcome.job.strategy == BASE
    }
    found = []
    for outcome in evaluation.outcomes:
        job, numbers = outcome.job, Found()
        if outcome.status is Status.DONE:
            run = FinishedRun(job.folder)
            numbers = Found(drive_metrics(run, qualities.get(job.folder, {})))
            segments = pieces.get(job.sequence, Pieces()).segments
            if segments:
                truth = _truth(evaluation.out_dir, job.sequence)
                by_motion = motion_metrics(run, bases.get(job.sequence), segments, truth)
                numbers = replace(numbers, by_motion=by_motion)
        found.append(numbers)
    return tuple(found)


def _qualities(
    evaluation: Evaluation, workers: Workers
) -> tuple[dict[Path, dict[str, float | None]], list[str]]:
    """Quality of every finished run's map by its folder, and remarks on what could not be had."""
    finished = _finished(evaluation)
    bases = {
        outcome.job.sequence: outcome.job.folder
        for outcome in finished
        if outcome.job.strategy == BASE
    }
    jobs = [QualityJob(item.job.folder, bases.get(item.job.sequence)) for item in finished]
    stored = {job: stored_quality(job) for job in jobs}
    found = {job.folder: asdict(quality) for job, quality in stored.items() if quality is not None}
    remarks = []
    todo = [job for job, quality in stored.items() if quality is None]
    for job, future in workers.run(run_quality_job, todo):
        error = None if future.cancelled() else future.exception()
        if future.cancelled() or error is not None:
            reason = ' '.join(str(error or 'given up').split())
            remarks.append(f'{job.folder}: its map could not be compared ({reason})')
        else:
            found[job.folder] = asdict(future.result())
    return found, remarks


def _cut(evaluation: Evaluation) -> dict[str, Pieces]:
    """Every sequence in pieces by motion: by the truth, or by an estimate where there is none."""
    folders: dict[str, dict[str, Path]] = {}
    for outcome in _finished(evaluation):
        folders.setdefault(outcome.job.sequence, {})[outcome.job.strategy] = outcome.job.folder
    pieces = {}
    for sequence, by_strategy in folders.items():
        truth = _truth(evaluation.out_dir, sequence)
        if truth is not None:
            pieces[sequence] = Pieces(segment_by_motion(truth), 'truth')
            continue
        strategy = next(name for name in (*CUT_BY, *by_strategy) if name in by_strategy)
        estimate = FinishedRun(by_strategy[strategy]).trajectory
        pieces[sequence] = Pieces(segment_by_motion(estimate), strategy)
    return pieces


def _truth(out_dir: Path, sequence: str) -> Trajectory | None:
    path = out_dir / sequence / cache.TRUTH_FILE
    return read_truth(path) if path.is_file() else None


def _remarks(evaluation: Evaluation, pieces: Mapping[str, Pieces]) -> list[str]:
    """What a reader of the table has to know besides its numbers."""
    lines = []
    runs = {item.job.sequence: FinishedRun(item.job.folder) for item in _finished(evaluation)}
    for sequence, run in runs.items():
        if not (evaluation.out_dir / sequence / cache.TRUTH_FILE).is_file():
            lines.append(f'{sequence}: no truth, so no errors against it')
        elif run.stats.get('rpe_translation_rmse_m') is None:
            lines.append(f'{sequence}: the truth covers fewer than two poses, so no errors')
    if pieces:
        lines.append(
            'components, distance to base map, plane variance and warnings: of whole drives only'
        )
    for sequence, cut in pieces.items():
        seconds = {
            motion: sum(piece.seconds for piece in cut.segments if piece.motion is motion)
            for motion in Motion
        }
        found = [f'{motion_title(m).lower()} {s:.1f} s' for m, s in seconds.items() if s > 0.0]
        lines.append(
            f'{sequence}: cut by the {"truth" if cut.source == "truth" else f"{cut.source} run"} '
            f'into {", ".join(found) or "nothing, it is too short"}'
        )
    return [*lines, *_verification(evaluation), *_findings(evaluation), *_failures(evaluation)]


def _verification(evaluation: Evaluation) -> list[str]:
    """How well the fast score agrees with the direct one, if --verify asked."""
    checks = [
        stats['verification']
        for item in _finished(evaluation)
        if 'verification' in (stats := FinishedRun(item.job.folder).stats)
    ]
    if not checks:
        return []
    windows, same, near, scored = (
        sum(check[name] for check in checks)
        for name in (
            'windows_with_a_choice',
            'same_winner',
            'same_or_within_half_percent',
            'candidates_scored',
        )
    )
    fast, direct = (
        sum(check[name] * check['candidates_scored'] for check in checks) / max(scored, 1)
        for name in ('fast_ms_per_candidate', 'direct_ms_per_candidate')
    )
    worst = max(check['worst_regret_percent'] for check in checks)
    return [
        f'Fast against direct MOM: the same winner, or one within 0.5 %, in {near} of {windows} '
        f'windows (the same in {same}, worst {worst:.2f} %); {fast:.2f} ms against {direct:.2f} ms '
        'a candidate'
    ]


def flagged(evaluation: Evaluation) -> list[Job]:
    """The finished jobs whose numbers are not to be trusted: an error was found.

    Args:
        evaluation: What was run.
    """
    return [
        outcome.job
        for outcome in _finished(evaluation)
        if any(
            item['severity'] == Severity.ERROR for item in unmended(FinishedRun(outcome.job.folder))
        )
    ]


def _findings(evaluation: Evaluation) -> list[str]:
    """A line for every finding, errors last; strategies that share it stand in one."""
    lines: dict[tuple[str, str, str], list[tuple[str, Mapping[str, str]]]] = {}
    for outcome in _finished(evaluation):
        for item in unmended(FinishedRun(outcome.job.folder)):
            key = outcome.job.sequence, item['rule'], item['sensor']
            lines.setdefault(key, []).append((outcome.job.strategy, item))
    told = []
    for (sequence, rule, sensor), found in lines.items():
        worst = min((item for _, item in found), key=_rank)
        strategies = ', '.join(strategy for strategy, _ in found)
        subject = f'{sensor}: ' if sensor else ''
        text = f'{worst["severity"]}: {sequence}, {strategies}: {subject}{worst["text"]} ({rule})'
        told.append((-_rank(worst), text))
    return [text for _, text in sorted(told, key=lambda pair: pair[0])]


def _rank(item: Mapping[str, str]) -> int:
    """Place of a finding among others, errors first."""
    return int(item['severity'] != Severity.ERROR)


def _failures(evaluation: Evaluation) -> list[str]:
    """A line for every failed job; strategies that fail for the same reason share one."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for outcome in evaluation.outcomes:
        if outcome.error is not None:
            key = (outcome.job.sequence, outcome.error)
            reasons.setdefault(key, []).append(outcome.job.strategy)
    return [
        f'failed: {sequence}, {", ".join(strategies)}: {reason}'
        for (sequence, reason), strategies in reasons.items()
    ]
