"""The main numbers of a run as ``map`` prints them: those that everybody wants, or all."""

from collections.abc import Mapping, Sequence
from typing import Any


def brief(stats: Mapping[str, Any], seconds: float) -> str:
    """What a user wants to know of a run, one a line, aligned.

    Args:
        stats: The keys of ``stats.json``.
        seconds: How long all of it took, reading, drawing and writing included.
    """
    connected = stats['components'] == 1
    rows = [
        (
            'drive',
            f'{stats["drive_s"]:.1f} s, done in {seconds:.1f} s; mapping alone took '
            f'{stats["wall_s"]:.1f} s, real-time factor {stats["real_time_factor"]:.1f}',
        ),
        (
            'graph',
            f'{_against(stats, "vertices", "variables")}'
            + ('' if connected else f'; in {stats["components"]} parts that nothing connects')
            + _bridges(stats),
        ),
    ]
    if 'ate_rmse_m' in stats:
        rows.append(
            (
                'accuracy',
                f'ATE {stats["ate_rmse_m"]:.4f} m, RPE per second '
                f'{_metres(stats["rpe_per_second_translation_rmse_m"])}',
            )
        )
    rows += _closures(stats)
    place = '' if stats['georeferenced'] else ', not georeferenced: in a frame of its own'
    rows.append(('map', f'{stats["map_points"]} points{place}'))
    if 'sessions' in stats:
        rows.append(('sessions', _sessions(stats['sessions'])))
    return _aligned(rows + _losses(stats))


def summary(stats: Mapping[str, Any]) -> str:
    """The main numbers of a run, one a line, aligned.

    Args:
        stats: The keys of ``stats.json``.
    """
    by_kind = stats['factors_by_kind']
    rows = [
        ('strategy', stats['strategy']),
        ('clusters', _against(stats, 'clusters')),
        ('vertices', _against(stats, 'vertices')),
        ('factors', _against(stats, 'factors')),
        ('', ', '.join(f'{count} {kind}' for kind, count in by_kind.items())),
        ('components', _components(stats)),
        *_closures(stats),
        ('total time shift', f'{stats["total_time_shift_s"]:.4f} s'),
        ('solver error', f'{stats["solver_error"]:.4f}'),
    ]
    if 'rpe_translation_rmse_m' in stats:
        rows += [
            (
                'RPE',
                f'{stats["rpe_translation_rmse_m"]:.4f} m, '
                f'{stats["rpe_rotation_rmse_deg"]:.3f} deg between consecutive poses',
            ),
            ('RPE per second', _metres(stats['rpe_per_second_translation_rmse_m'])),
            ('ATE', f'{stats["ate_rmse_m"]:.4f} m'),
        ]
    rows += [
        (
            'candidates',
            f'{stats["candidates_enumerated"]} enumerated, '
            f'{stats["candidates_connected"]} connected, {stats["candidates_solved"]} solved '
            f'in {stats["windows"]} windows',
        ),
        (
            'score',
            _counts(stats['selection.score']),
        ),
        (
            'time',
            f'{stats["wall_s"]:.1f} s for {stats["drive_s"]:.1f} s of driving, '
            f'real-time factor {stats["real_time_factor"]:.1f}',
        ),
        (
            'a window',
            f'{1e3 * stats["window_median_s"]:.0f} ms median, first tenth '
            f'{1e3 * stats["window_first_tenth_s"]:.0f} ms, last tenth '
            f'{1e3 * stats["window_last_tenth_s"]:.0f} ms',
        ),
        ('peak memory', f'{stats["peak_rss_mb"]:.0f} MB'),
        ('map', f'{stats["map_points"]} points'),
    ]
    if 'verification' in stats:
        check = stats['verification']
        rows.append(
            (
                'fast against direct',
                f'{check["agreement_percent"]:.1f} % of {check["windows_with_a_choice"]} windows '
                f'agree, direct takes {check["direct_over_fast"]:.0f} times as long',
            )
        )
    if stats['standing_windows']:
        rows.append(
            (
                'at rest',
                f'{stats["standing_windows"]} windows, whose {stats["joined_measurements"]} '
                'measurements joined the pose before',
            )
        )
    return _aligned(rows + _losses(stats))


def _sessions(sessions: Sequence[Mapping[str, Any]]) -> str:
    how = ' and '.join(sorted({one['joined_by'] for one in sessions} - {''}))
    poses = ' + '.join(str(one['clusters']) for one in sessions)
    return f'{len(sessions)}, joined by {how}: {poses} poses'


def _losses(stats: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What is not in the map, and remarks: nobody is spared them."""
    rows = []
    dropped = [
        f'{count} of {sensor} ({reason})'
        for sensor, reasons in stats['dropped'].items()
        for reason, count in reasons.items()
    ]
    if dropped:
        rows.append(('not used', ', '.join(dropped)))
    if stats['failed_windows']:
        rows.append(('windows failed', f'{stats["failed_windows"]}, left out; the log says why'))
    rows += [('note', f'{text}: {count}x') for text, count in stats['notes'].items()]
    if stats['interrupted']:
        rows.append(('interrupted', 'the rest of the input was not read'))
    return rows


def _aligned(rows: list[tuple[str, str]]) -> str:
    width = max(len(name) for name, _ in rows)
    return '\n'.join(f'{name:<{width}}  {text}' for name, text in rows)


def _metres(value: float | None) -> str:
    return 'none, no two poses are about a second apart' if value is None else f'{value:.4f} m'


def _counts(counts: Mapping[str, int]) -> str:
    return ', '.join(f'{name} {count}x' for name, count in counts.items())


def _against(stats: Mapping[str, Any], name: str, called: str = '') -> str:
    percent = stats[f'compression_{name}_percent']
    word = 'fewer' if percent >= 0.0 else 'more'
    count = f'{stats[name]} {called}' if called else stats[name]
    return f'{count} ({abs(percent):.1f} % {word} than the {stats[f"base_{name}"]} of base)'


def _components(stats: Mapping[str, Any]) -> str:
    count = stats['components']
    text = '1, the graph is connected' if count == 1 else f'{count}, the graph is not connected'
    return text + _bridges(stats)


def _closures(stats: Mapping[str, Any]) -> list[tuple[str, str]]:
    counts = stats.get('closures')
    if not counts:
        return []
    others = {name: n for name, n in counts.items() if name not in ('candidates', 'accepted')}
    text = f'{counts["accepted"]} of {counts["candidates"]} pairs of places that may be the same'
    return [('loops closed', text + (f'; not: {_counts(others)}' if others else ''))]


def _bridges(stats: Mapping[str, Any]) -> str:
    if not stats['bridges']:
        return ''
    return f'; {stats["bridges"]} of {stats["clusters"]} poses by a bridge, which is a guess'
