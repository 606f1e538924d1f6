"""Findings in words and as plain values."""

from incremental_mapper.checks.finding import Finding, Severity, ranked

GRAVITY = Finding('no_gravity', Severity.WARNING, 'imu', 'rests at 0.1 m/s^2', 'leave it out')


def test_a_finding_names_sensor_rule_and_remedy_in_one_line():
    assert GRAVITY.line() == 'imu: rests at 0.1 m/s^2 (no_gravity); leave it out'
    assert GRAVITY.titled().startswith('warning: imu: ')


def test_of_one_rule_and_sensor_the_newest_counts_and_the_worst_leads():
    newer = Finding('no_gravity', Severity.WARNING, 'imu', 'rests at 0.2 m/s^2')
    lost = Finding('sensor_lost', Severity.ERROR, 'left', 'no scan was used')
    assert ranked([GRAVITY, newer, lost]) == (lost, newer)


def test_plain_values_hold_everything():
    tree = Finding('a', Severity.MENDED, '', 'b', 'c', {'imu': {'topic': 'd'}}).to_tree()
    assert tree == {
        'rule': 'a',
        'severity': 'mended',
        'sensor': '',
        'text': 'b',
        'remedy': 'c',
        'settings': {'imu': {'topic': 'd'}},
    }
