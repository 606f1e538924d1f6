"""The main numbers of a run in words."""

import pytest

from incremental_mapper.results.summary import brief, summary


@pytest.fixture
def stats(map_light, light_drive):
    return map_light(light_drive).stats


def row(text, name):
    return next(line for line in text.splitlines() if line.startswith(name))


def test_less_than_nothing_saved_reads_more(stats):
    assert 'fewer than the' in row(summary(stats | {'compression_factors_percent': 3.0}), 'factors')
    more = row(summary(stats | {'compression_factors_percent': -0.3}), 'factors')
    assert '(0.3 % more than the' in more and '-' not in more


def test_a_graph_that_hangs_on_bridges_is_not_just_connected(stats):
    assert row(summary(stats), 'components').endswith('1, the graph is connected')
    held = row(summary(stats | {'bridges': 106, 'clusters': 110}), 'components')
    assert '106 of 110 poses by a bridge' in held


def test_a_trajectory_too_short_for_an_error_per_second_says_so(stats):
    """A map that ends after a few windows, by Ctrl-C for one, ended in a traceback here."""
    errors = {
        'rpe_translation_rmse_m': 0.01,
        'rpe_rotation_rmse_deg': 0.1,
        'rpe_per_second_translation_rmse_m': None,
        'ate_rmse_m': 0.02,
    }
    short = summary(stats | errors)
    assert row(short, 'RPE per second').endswith('none, no two poses are about a second apart')
    assert row(short, 'ATE').endswith('0.0200 m')


def test_a_vehicle_that_stood_is_told(stats):
    assert 'at rest' not in summary(stats | {'standing_windows': 0})
    stood = summary(stats | {'standing_windows': 82, 'joined_measurements': 171})
    assert row(stood, 'at rest').endswith(
        '82 windows, whose 171 measurements joined the pose before'
    )


def test_brief_says_what_everybody_wants_to_know(stats):
    short = brief(stats, 12.34)
    assert f'done in 12.3 s; mapping alone took {stats["wall_s"]:.1f} s' in row(short, 'drive')
    assert row(short, 'graph').endswith('of base)') and 'variables' in row(short, 'graph')
    assert f'ATE {stats["ate_rmse_m"]:.4f} m' in row(short, 'accuracy')
    assert 'not georeferenced' in row(brief(stats | {'georeferenced': False}, 1.0), 'map')
    for inside in ('solver error', 'candidates', 'a window', 'score'):
        assert inside not in short and inside in summary(stats)


def test_brief_spares_nobody_what_is_missing(stats):
    losses = {
        'components': 3,
        'bridges': 2,
        'dropped': {'left': {'truncated': 4}},
        'failed_windows': 1,
        'interrupted': True,
    }
    short = brief(stats | losses, 1.0)
    assert 'in 3 parts that nothing connects' in short and 'by a bridge, which is a guess' in short
    assert row(short, 'not used').endswith('4 of left (truncated)')
    assert row(short, 'windows failed') and row(short, 'interrupted')
