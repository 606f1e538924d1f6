"""The main numbers of a run in words."""

import pytest

from incremental_mapper.results.summary import summary


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
