"""Findings in a terminal: readable, the worst last."""

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.cli.findings_text import print_findings, wrapped

LONG = Finding(
    'lidars_disagree',
    Severity.ERROR,
    'left',
    'its motion is turned by 90 degrees against the motion of the other LiDARs, over 60 scans',
    'check lidars.left.T_base_sensor: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]',
)
SHORT = Finding('sensor_unused', Severity.WARNING, 'imu', '500 received, none used')


def test_no_line_is_wider_than_the_terminal_and_nothing_is_lost():
    lines = wrapped(LONG, 80)
    assert max(map(len, lines)) < 80
    assert ' '.join(' '.join(lines).replace('-> ', '').split()) == LONG.titled().replace(');', ')')


def test_the_remedy_begins_a_line_of_its_own():
    assert [line for line in wrapped(LONG, 80) if line.startswith('    -> check lidars.left')]


def test_a_path_is_not_cut():
    path = '/a/' + 'b' * 90
    lines = wrapped(Finding('rule', Severity.WARNING, '', f'see {path}'), 60)
    assert any(path in line for line in lines)


def test_errors_are_printed_last_and_one_a_line_where_no_terminal_is(capsys):
    print_findings([LONG, SHORT])
    assert capsys.readouterr().err.splitlines() == [SHORT.titled(), LONG.titled()]
