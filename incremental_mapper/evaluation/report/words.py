"""The summary in words and the few numbers that it rests on."""

from collections.abc import Sequence
from dataclasses import dataclass

from incremental_mapper.checks.finding import Severity
from incremental_mapper.evaluation.metrics import Metrics
from incremental_mapper.evaluation.record import METHOD, RecordedEvaluation, RecordedSequence
from incremental_mapper.evaluation.report.drawings import drive_seconds
from incremental_mapper.evaluation.table import BASE, Entry, mean_metrics

SAME = 0.1
"""Errors that differ by less than this share are called about the same."""
PER_SECOND = 'rpe_per_second_translation_rmse_m'
ERRORS = (
    (PER_SECOND, 'relative pose error per second'),
    ('ate_rmse_m', 'absolute trajectory error'),
    (
        'rpe_translation_rmse_m',
        'relative pose error from one pose to the next, a longer step the fewer poses there are,',
    ),
)


@dataclass(frozen=True, slots=True)
class Tile:
    """One number of the summary: what it is, and what it is compared with."""

    number: str
    what: str
    beside: str = ''


def what_ran(evaluation: RecordedEvaluation) -> str:
    """One sentence on the inputs."""
    done = [sequence for sequence in evaluation.sequences if sequence.runs]
    seconds = sum(map(drive_seconds, done))
    kinds = sorted({str(sequence.record['kind']) for sequence in done})
    text = (
        f'{_count(len(evaluation.sequences), "drive")} ({", ".join(kinds) or "none readable"}), '
        f'{seconds:.1f} s together, each mapped with '
        f'{_count(len(evaluation.strategies), "strategy", "strategies")}: '
        f'{", ".join(evaluation.strategies)}.'
    )
    failed = sum(len(sequence.jobs) - len(sequence.runs) for sequence in evaluation.sequences)
    if failed:
        text += f' {_count(failed, "run")} failed.'
    return text


def lead_strategy(evaluation: RecordedEvaluation) -> str | None:
    """The strategy that the summary speaks of."""
    finished = {name for sequence in evaluation.sequences for name in sequence.runs}
    order = [METHOD, *(name for name in evaluation.strategies if name != BASE), BASE]
    return next((name for name in order if name in finished), None)


def tiles(evaluation: RecordedEvaluation, lead: str) -> list[Tile]:
    """The numbers of the lead, beside those of base; means over the drives."""
    found: dict[str, dict[str, Entry]] = {}
    for entry in evaluation.entries():
        found.setdefault(entry.sequence, {})[entry.strategy] = entry
    pair = [lead, BASE] if BASE in evaluation.strategies and lead != BASE else [lead]
    means = mean_metrics(list(found.values()), pair)
    own, base = means[0], (means[1] if len(means) > 1 else {})
    made = []
    saving = own.get('compression_vertices_percent')
    if saving is not None and lead != BASE:
        made.append(Tile(f'{saving:.1f} %', 'fewer variables than base', _range(found, lead)))
    for name, unit, digits, what in (
        ('rpe_per_second_translation_rmse_m', ' m', 4, 'relative pose error per second'),
        ('ate_rmse_m', ' m', 4, 'absolute trajectory error'),
        ('rpe_translation_rmse_m', ' m', 4, 'relative pose error, pose to pose'),
        ('rpe_rotation_rmse_deg', '°', 3, 'relative rotation error, pose to pose'),
        ('map_distance_m', ' cm', 1, "mean distance to base's map"),
        ('real_time_factor', '', 1, 'real-time factor'),
    ):
        value, other = own.get(name), base.get(name)
        if value is None or (name == 'map_distance_m' and lead == BASE):
            continue
        scale = 100.0 if unit == ' cm' else 1.0
        beside = (
            ''
            if other is None or name == 'map_distance_m'
            else (f'base: {other * scale:.{digits}f}{unit}')
        )
        made.append(Tile(f'{value * scale:.{digits}f}{unit}', what, beside))
    return made


def verdict(evaluation: RecordedEvaluation, lead: str) -> list[str]:
    """Sentences that say what the numbers mean."""
    found: dict[str, dict[str, Entry]] = {}
    for entry in evaluation.entries():
        found.setdefault(entry.sequence, {})[entry.strategy] = entry
    if lead == BASE:
        return [_connected(evaluation.sequences, BASE)]
    both = BASE in evaluation.strategies
    own, base = (
        mean_metrics(list(found.values()), [lead, BASE])
        if both
        else (mean_metrics(list(found.values()), [lead])[0], {})
    )
    told = []
    saving = own.get('compression_vertices_percent')
    if saving is not None:
        word = 'fewer' if saving >= 0.0 else 'more'
        told.append(f'{lead} keeps {abs(saving):.1f} % {word} variables than base')
    judged = _compared(own, base, PER_SECOND)
    if judged:
        told.append(f'its drift over a second is {judged} that of base')
    heading = '; '.join(told) or f'{lead} was mapped'
    return [
        f'{heading}.',
        *_errors(own, base),
        *(_connected(evaluation.sequences, name) for name in ([lead, BASE] if both else [lead])),
    ]


def failures(evaluation: RecordedEvaluation) -> list[tuple[str, str, str]]:
    """Sequence, strategies and reason of the runs that are not done."""
    found: dict[tuple[str, str], list[str]] = {}
    for sequence in evaluation.sequences:
        for strategy, job in sequence.jobs.items():
            if strategy not in sequence.runs:
                reason = str(job['error'] or job['status'])
                found.setdefault((sequence.name, reason), []).append(strategy)
    return [(name, ', '.join(names), reason) for (name, reason), names in found.items()]


def flagged(sequence: RecordedSequence) -> list[tuple[str, str]]:
    """Strategies and findings of a sequence's runs that are not to be trusted."""
    found: dict[str, list[str]] = {}
    for strategy, job in sequence.jobs.items():
        for item in job.get('findings') or ():
            if item['severity'] == Severity.ERROR:
                subject = f'{item["sensor"]}: ' if item['sensor'] else ''
                found.setdefault(f'{subject}{item["text"]}', []).append(strategy)
    return [(', '.join(names), text) for text, names in found.items()]


def _errors(own: Metrics, base: Metrics) -> list[str]:
    """The errors, each against that of base; over a second first, which steps do not change."""
    told = []
    for name, what in ERRORS:
        value, other = own.get(name), base.get(name)
        if value is None:
            continue
        judged = _compared(own, base, name)
        beside = f', {judged} that of base ({other:.4f} m)' if judged else ''
        told.append(f'Its {what} is {value:.4f} m{beside}.')
    return told or ['There is no truth to measure errors against.']


def _compared(own: Metrics, base: Metrics, name: str) -> str:
    """How an error stands to that of base, in words; empty where one of both is not known."""
    value, other = own.get(name), base.get(name)
    if value is None or not other:
        return ''
    change = value / other - 1.0
    if abs(change) < SAME:
        return 'about the same as'
    if change > 0:
        return (
            f'{100 * change:.0f}\N{NO-BREAK SPACE}% above'
            if change < 1
            else f'{value / other:.1f} times'
        )
    return f'{-100 * change:.0f}\N{NO-BREAK SPACE}% below'


def _connected(sequences: Sequence[RecordedSequence], strategy: str) -> str:
    runs = [sequence.runs[strategy] for sequence in sequences if strategy in sequence.runs]
    whole = sum(run.stats.get('components') == 1 for run in runs)
    if whole == len(runs):
        return f'Every graph of {strategy} is connected.'
    verb = 'is' if whole == 1 else 'are'
    return f'{whole} of the {len(runs)} graphs of {strategy} {verb} connected.'


def _range(found: dict[str, dict[str, Entry]], lead: str) -> str:
    values = [
        value
        for entries in found.values()
        if lead in entries
        and (value := entries[lead].metrics.get('compression_vertices_percent')) is not None
    ]
    if len(values) < 2:
        return ''
    return f'{min(values):.1f} to {max(values):.1f} % by drive'


def _count(number: int, one: str, many: str = '') -> str:
    return f'{number} {one if number == 1 else many or one + "s"}'
