"""What the log says of measurements that are left out."""

import importlib.util
import sys
from pathlib import Path

from incremental_mapper.ros.drop_log import DropLog
from incremental_mapper.ros.drop_reasons import DROP_REASONS

TOOLS = Path(__file__).resolve().parents[2] / 'docs' / 'tools'


def test_a_reason_is_told_with_meaning_remedy_and_example():
    log = DropLog()
    example = {('left', 'no_stamp'): 'the header stamp is 0'}
    (line,) = log.look(1.0, {'left': {'no_stamp': 3}}, example)
    assert line == (
        'left: 3 left out, no_stamp: the header stamp is not set; set header stamps in the driver '
        '(the first: the header stamp is 0)'
    )


def test_then_once_a_minute_with_what_came_since():
    log = DropLog()
    lines = [log.look(float(now), {'imu': {'frozen': now}}, {}) for now in range(1, 130)]
    assert [len(found) for found in lines].count(1) == 3
    assert lines[60] == ['imu: 60 more left out in 60 s (frozen)']
    # Silence while nothing comes.
    assert [log.look(float(now), {'imu': {'frozen': 129}}, {}) for now in range(200, 400)][1:] == [
        []
    ] * 199


def test_counts_that_begin_anew_are_counted_on():
    log = DropLog()
    log.look(0.0, {'imu': {'frozen': 50}}, {})
    log.look(1.0, {}, {})
    assert log.look(61.0, {'imu': {'frozen': 2}}, {}) == ['imu: 2 more left out in 61 s (frozen)']


def test_each_sensor_and_reason_is_told_of_and_wishes_are_not():
    drops = {'left': {'no_stamp': 1, 'paused': 9}, 'right': {'no_stamp': 1, 'never_heard_of': 1}}
    lines = DropLog().look(0.0, drops, {})
    assert len(lines) == 3
    assert any('docs/messages.md' in line for line in lines)


def test_every_reason_of_the_code_is_explained():
    sys.path.insert(0, str(TOOLS))
    try:
        spec = importlib.util.spec_from_file_location('said', TOOLS / 'said_messages.py')
        said = importlib.util.module_from_spec(spec)
        sys.modules['said'] = said
        spec.loader.exec_module(said)
    finally:
        sys.path.remove(str(TOOLS))
        sys.modules.pop('said', None)
    reasons = {reason for _, reason in said.drop_reasons()}
    assert reasons - DROP_REASONS.keys() == set()
