"""Levels of inputs and of the flow of windows, on plain numbers."""

import pytest

from incremental_mapper.ros.vitals import Events, Flow, InputCounts, InputVitals, Level, grown


class Input:
    """An input that is looked at every second."""

    def __init__(self, rate, needed=True):
        self.vitals, self.rate = InputVitals(needed), rate
        self.now, self.received, self.heard, self.lost, self.dropped = 0.0, 0, None, 0, {}

    def second(self, share=1.0, lost=0, **dropped):
        """Let a second pass in which a share of the messages comes."""
        self.now += 1.0
        due = int(self.now * self.rate) - int((self.now - 1.0) * self.rate)
        came = round(due * share)
        self.received += came
        if came:
            self.heard = int(self.now * self.rate) / self.rate
        self.lost += lost
        for reason, count in dropped.items():
            self.dropped[reason] = self.dropped.get(reason, 0) + count
        counts = InputCounts(self.received, self.heard, self.lost, dict(self.dropped))
        return self.vitals.look(self.now, counts)


def lidar():
    found = Input(10.0)
    for _ in range(5):
        assert found.second().level is Level.OK
    return found


def test_input_that_never_came():
    found = Input(0.0)
    assert found.second().message == 'no message yet'
    assert found.second().level is Level.WARN


def test_silence_is_a_warning_within_two_periods_then_an_error_and_ends():
    found = lidar()
    levels = [found.second(share=0.0).level for _ in range(7)]
    assert Level.WARN in levels[:2] and Level.ERROR not in levels[:4]
    assert levels[-1] is Level.ERROR
    assert found.second().level is Level.OK
    assert found.vitals.period == pytest.approx(0.1)


def test_slow_input_may_be_silent_for_as_long_as_it_mostly_is():
    found = Input(0.25)
    found.second()
    for _ in range(3):
        found.second()
    levels = [found.second().level for _ in range(24)]
    assert set(levels[8:]) == {Level.OK}
    assert found.vitals.period == pytest.approx(4.0)
    levels = [found.second(share=0.0).level for _ in range(45)]
    assert levels[:8] == [Level.OK] * 8 and levels[9] is Level.WARN
    assert levels[-1] is Level.ERROR


def test_lidar_of_which_all_is_rejected():
    found = lidar()
    assert found.second(no_points_in_range=5).level is Level.WARN
    verdict = found.second(no_points_in_range=9, not_finite=1)
    assert verdict.level is Level.ERROR
    assert verdict.message == '10 of 10 messages cannot be used: no_points_in_range, not_finite'
    assert found.second(no_points_in_range=3).level is Level.OK
    # What was rejected before is no matter now.
    assert found.second().level is Level.OK


def test_fixes_may_all_be_rejected():
    found = Input(1.0, needed=False)
    for _ in range(4):
        found.second()
    assert found.second(no_fix=1).level is Level.OK  # one of three
    for _ in range(3):
        verdict = found.second(no_fix=1)
    assert verdict.level is Level.WARN and 'no_fix' in verdict.message


def test_what_is_thrown_away_afterwards_or_on_demand_is_no_rejection():
    found = lidar()
    assert found.second(before_mend=200).level is Level.OK
    assert found.second(paused=10).level is Level.OK


@pytest.mark.parametrize('loss', [{'lost': 1}, {'queue_full': 1}, {'late': 1}])
def test_losses_count_in_their_own_period(loss):
    found = lidar()
    assert found.second(**loss).level is Level.WARN
    assert found.second().level is Level.OK


def test_counts_that_begin_anew_are_no_negative_ones():
    found = lidar()
    found.second(not_finite=10)
    found.dropped = {}
    assert found.second().level is Level.OK
    assert found.second(not_finite=10).level is Level.ERROR
    assert grown({'a': 3, 'b': 1}, {'a': 2, 'b': 5}) == {'a': 1, 'b': 1}


def test_window_that_does_not_come_while_data_do():
    flow = Flow(5.0)
    verdicts = [flow.look(now, 10 * now, now, 0.0) for now in range(1, 20)]
    assert verdicts == [None] * 19
    verdicts = [flow.look(now, 10 * now, 19, 0.0) for now in range(20, 27)]
    assert verdicts[:4] == [None] * 4
    assert verdicts[-1].level is Level.ERROR
    assert verdicts[-1].message == 'no window for 7 s while data come in'
    assert flow.look(27, 270, 20, 0.0) is None


def test_first_window_is_waited_for_from_the_first_message_on():
    flow = Flow(5.0)
    assert [flow.look(now, 0, 0, 0.0) for now in range(1, 60)] == [None] * 59
    assert [flow.look(now, now, 0, 0.0) for now in range(60, 64)] == [None] * 4
    assert flow.look(64, 64, 0, 0.0) is not None


def test_rare_messages_do_not_end_the_wait():
    flow = Flow(5.0)
    verdicts = [flow.look(0.1 * k, k // 10, 0, 0.0) for k in range(1, 80)]
    assert verdicts[-1] is not None


def test_silence_of_all_is_an_error_and_no_wait_for_windows():
    flow = Flow(5.0)
    flow.look(1.0, 10, 10, 0.0)
    assert flow.look(3.0, 10, 10, 1.9).message == 'no input at all for 1.9 s'
    assert flow.look(60.0, 10, 10, 59.0).level is Level.ERROR
    # When data come back the windows have their time again.
    assert flow.look(61.0, 20, 10, 0.0) is None
    assert flow.look(62.0, 30, 11, 0.0) is None


def test_rest_forgets_the_wait():
    flow = Flow(5.0)
    flow.look(1.0, 10, 1, 0.0)
    flow.look(5.0, 20, 1, 0.0)
    flow.rest(19.0)
    assert flow.look(20.0, 30, 1, 0.0) is None
    assert flow.look(25.0, 30, 1, 0.0) is not None


def test_events_are_shown_for_a_while():
    events = Events()
    assert events.recent(0.0, {'failures': 0}) == set()
    assert events.recent(1.0, {'failures': 1}) == {'failures'}
    assert events.recent(9.0, {'failures': 1}) == {'failures'}
    assert events.recent(12.0, {'failures': 1}) == set()
