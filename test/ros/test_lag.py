"""How old the last measurement of a window is when it is told of."""

import pytest

pytest.importorskip('rclpy')

from incremental_mapper.ros.lag import Lag


def test_lag_is_since_the_last_measurement_of_a_window_and_the_worst_counts_once():
    lag = Lag()
    for stamp, received in [(0, 10.0), (50, 10.05), (100, 10.1), (150, 10.15)]:
        lag.took(stamp, received)
    lag.told(0, 100, 11.05)
    lag.told(100, 200, 10.45)
    assert lag.worst() == pytest.approx(1.0)
    assert lag.worst() == 0.0


def test_windows_whose_stamps_nobody_received_and_those_of_a_map_before_say_nothing():
    lag = Lag()
    lag.took(0, 10.0)
    lag.told(1000, 1100, 20.0)
    lag.took(0, 30.0)
    lag.restart()
    lag.told(0, 100, 50.0)
    assert lag.worst() == 0.0
