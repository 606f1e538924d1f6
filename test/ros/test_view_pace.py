"""How often views are made."""

from incremental_mapper.ros.view_pace import ViewPace


def moments(pace, period, delivered, until=100):
    """The seconds, in tenths, at which a view is made."""
    made = []
    for now in range(until):
        passed = now / 10 - pace.last
        if pace.due(now / 10, period, lambda passed=passed: delivered(passed)):
            pace.last = now / 10
            made.append(now)
    return made


def test_period_holds_where_views_are_cheap():
    assert moments(ViewPace(), 2.0, lambda since: True) == [0, 20, 40, 60, 80]


def test_what_is_dear_is_made_seldom():
    assert moments(ViewPace(cost=0.4), 2.0, lambda since: True) == [0, 40, 80]


def test_slow_reader_gets_each_whole():
    assert moments(ViewPace(), 1.0, lambda since: since >= 2.95) == [0, 30, 60, 90]


def test_reader_that_hangs_does_not_keep_the_others_from_theirs():
    assert moments(ViewPace(), 1.0, lambda since: False, until=250) == [0, 100, 200]


def test_long_period_is_kept_though_nothing_is_delivered():
    assert moments(ViewPace(), 15.0, lambda since: False, until=310) == [0, 150, 300]
