"""A check that raises costs itself, never the map."""

import pytest

from incremental_mapper.checks.finding import Finding, Severity
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.settings import make_config

SEEN = Finding('imu_in_g', Severity.WARNING, 'imu', 'a text')


class Broken:
    """Stands where a part of the watch looks, and cannot."""

    def __getattr__(self, name):
        def look(*_):
            raise IndexError(f'{name} of nothing')

        return look


@pytest.fixture
def watch():
    watch = Watch(make_config({}))
    watch.add(SEEN)
    return watch


def test_what_a_look_raises_is_a_finding_and_goes_no_further(watch, caplog):
    watch._imu = Broken()
    for _ in range(3):
        watch.prepared([])
        watch.end()
    assert [finding.rule for finding in watch.findings()] == ['imu_in_g', 'check_failed']
    assert 'of nothing' in watch.findings()[1].text
    assert len([record for record in caplog.records if record.levelname == 'ERROR']) == 1


def test_judges_that_raise_do_not_keep_the_others_from_judging(watch):
    def broken():
        raise ZeroDivisionError

    found = watch.final(broken, lambda: [Finding('map_empty', Severity.ERROR, '', 'no point')])
    assert [finding.rule for finding in found] == ['map_empty', 'imu_in_g', 'check_failed']
