"""One window of a finished run: its candidates, best first, and why the winner won."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from incremental_mapper.errors import InputError
from incremental_mapper.results.finished_run import FinishedRun

Row: TypeAlias = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Inspection:
    """One window.

    ``window`` is its row of windows.csv, ``candidates`` its rows of candidates.parquet, best
    first; ``reasons`` say why the winner won, a sentence each. ``start_s`` and ``end_s`` are
    seconds since the first cluster.
    """

    window: dict[str, str]
    start_s: float
    end_s: float
    strategy: str
    candidates: tuple[Row, ...]
    reasons: tuple[str, ...]


def window_at(run: FinishedRun, stamp: int) -> int:
    """Index of the window that holds a stamp (ns).

    Raises:
        InputError: None does.
    """
    for row in run.windows:
        if int(row['start_ns']) <= stamp < int(row['end_ns']):
            return int(row['window'])
    raise InputError(f'{run.folder}: no window at {run.seconds(stamp):.3f} s; {_extent(run)}')


def inspect_window(run: FinishedRun, index: int) -> Inspection:
    """Read one window of a finished run.

    Args:
        run: The run; ``candidates.parquet`` must be in its folder.
        index: The window's number, as in ``windows.csv``.

    Raises:
        InputError: The run has no such window, or a file cannot be read.
    """
    found = next((row for row in run.windows if int(row['window']) == index), None)
    if found is None:
        raise InputError(f'{run.folder}: no window {index}; {_extent(run)}')
    rows = sorted(run.candidates(index), key=_rank)
    return Inspection(
        window=dict(found),
        start_s=run.seconds(int(found['start_ns'])),
        end_s=run.seconds(int(found['end_ns'])),
        strategy=str(run.stats['strategy']),
        candidates=tuple(rows),
        reasons=tuple(why(rows, bool(int(found['cut'])), str(run.stats['strategy']))),
    )


def why(rows: Sequence[Row], cut: bool, strategy: str) -> list[str]:
    """Say why the winner of a window's candidates won, or why there is none.

    Args:
        rows: The window's rows of ``candidates.parquet``.
        cut: Whether there were more candidates than were tried.
        strategy: The name of the run's strategy.

    Returns:
        Sentences.
    """
    if not rows:
        return ['There was nothing to choose: no scan and no fix is in this window.']
    winner = next((row for row in rows if row['winner']), None)
    connected = [row for row in rows if row['connected']]
    if winner is None:
        return [
            f'None of the {len(rows)} candidates connects all its variables to the graph so far, '
            'so nothing was appended; the measurements were carried into the next window.'
            if not connected
            else 'No connected candidate could be solved; the measurements were carried into the '
            'next window.'
        ]
    name = f'Candidate {winner["candidate"]}'
    if winner['score_name'] == 'base':
        reasons = [f'{name} won unseen: {strategy} always takes one cluster a measurement.']
        if not winner['connected']:
            reasons.append('It is not connected; regularising priors hold its components in place.')
        return reasons
    if winner['score_name'] == 'bridged':
        return [
            f'{name} was taken because nothing had connected for too long: bridge '
            'factors join what its own leave unconnected.'
        ]
    scored = sorted((row for row in rows if row['score'] is not None), key=_rank)
    if winner['score'] is None:
        return [f'{name} won; its score was not recorded.']
    rivals = [row for row in scored if row is not winner]
    if not rivals:
        return [_alone(name, len(connected)), *_left_out(connected, scored, cut)]
    if winner['tied'] and rivals[0]['score'] < winner['score']:
        return [*_smallest(name, winner, scored), *_left_out(connected, scored, cut)]
    tied = [row for row in rivals if row['score'] == winner['score']]
    label = f'{winner["score_name"]} {winner["score"]:.6g}'
    if not tied:
        second = rivals[0]
        return [
            f'{name} has the lowest score of the {len(scored)} that were judged: {label}, '
            f'{_margin(winner["score"], second["score"])} candidate {second["candidate"]}.',
            *_left_out(connected, scored, cut),
        ]
    numbers = ', '.join(str(row['candidate']) for row in tied)
    reasons = [f'{name} shares the lowest score ({label}) with candidate {numbers}.']
    reasons.append(_told_apart(winner, tied))
    return [*reasons, *_left_out(connected, scored, cut)]


def _smallest(name: str, winner: Row, scored: Sequence[Row]) -> list[str]:
    """Why a candidate won that has not the lowest score."""
    lowest = min(scored, key=lambda row: float(row['score']))
    tied = [row for row in scored if row['tied']]
    smaller = [row for row in tied if row['vertices'] < winner['vertices']]
    reasons = [
        f'Candidate {lowest["candidate"]} has the lowest score ({lowest["score_name"]} '
        f'{lowest["score"]:.6g}), but its lead is no more than chance over {len(tied) - 1} others: '
        'they tie.',
        f'{name} is the smallest of those that tie and agree with their measurements: '
        f'{winner["vertices"]} vertices instead of {lowest["vertices"]}.',
    ]
    if smaller:
        reasons.append(
            f'{len(smaller)} that tie are smaller still, but contradict their measurements by more '
            'than chance allows, or turn a scan.'
        )
    return reasons


def _told_apart(winner: Row, tied: Sequence[Row]) -> str:
    """Which of the rules for equal scores decided; they are those of ``selection/selector.py``."""
    vertices, clusters = winner['vertices'], len(winner['clusters'])
    alike = [row for row in tied if row['vertices'] == vertices]
    if not alike:
        return f'It has the fewest vertices of them, {vertices}.'
    if all(len(row['clusters']) < clusters for row in alike):
        return f'Of those with {vertices} vertices it is the finest partition, {clusters} clusters.'
    return (
        f'Of those with {vertices} vertices and {clusters} clusters it has the earlier cuts, or '
        'else the earlier connections.'
    )


def _alone(name: str, connected: int) -> str:
    if connected <= 1:
        return f'{name} won because it is the only connected one.'
    return f'{name} won because it is the only one of {connected} connected that was judged.'


def _left_out(connected: Sequence[Row], scored: Sequence[Row], cut: bool) -> list[str]:
    """What to say of connected candidates without a score."""
    missing = [row for row in connected if row['score'] is None]
    told = []
    if missing and all(map(_merges, missing)) and not any(map(_merges, scored)):
        told.append(
            'Connected candidates that merge measurements were not judged: how far to move what is '
            'merged is unknown before the velocity is.'
        )
    elif missing:
        told.append(f'Of the connected ones {len(missing)} were not judged.')
    if cut:
        told.append('The search was cut: there are more candidates than were tried.')
    return told


def _merges(row: Row) -> bool:
    return any(cluster[0]['stamp_ns'] != cluster[-1]['stamp_ns'] for cluster in row['clusters'])


def _margin(best: float, second: float) -> str:
    """By how much the best is below the second, in words that end before its name."""
    if second <= 0.0:
        return f'{second - best:.3g} below'
    return f'{100.0 * (second - best) / second:.3g} % below'


def _rank(row: Row) -> tuple[bool, bool, float, int, int, int]:
    """The winner, then the judged ones by score, then the connected ones, then the others."""
    score = math.inf if row['score'] is None else row['score']
    size = (row['vertices'], -len(row['clusters']), row['candidate'])
    return (not row['winner'], not row['connected'], score, *size)


def _extent(run: FinishedRun) -> str:
    if not run.windows:
        return 'the run has none'
    first, last = run.windows[0], run.windows[-1]
    return (
        f'the run has windows {first["window"]} to {last["window"]}, from '
        f'{run.seconds(int(first["start_ns"])):.2f} s to {run.seconds(int(last["end_ns"])):.2f} s '
        'since the first cluster'
    )
