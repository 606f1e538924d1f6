"""How far measurements are read ahead of a window whose scans are not prepared yet."""

from concurrent.futures import Future

import numpy as np
import pytest

from incremental_mapper.config import Config
from incremental_mapper.frontend.front_end import Preparation
from incremental_mapper.mapping.load_shedding import MOST_BYTES, LoadShedding
from incremental_mapper.mapping.measurement_intake import MeasurementIntake
from incremental_mapper.measurements import make_scan

CONFIG = Config.model_validate(
    {
        'window': {'duration': 0.1, 'lateness': 0.0},
        'lidars': {'top': {'topic': 'points'}},
        'imu': {'enabled': False},
        'odometry': {'processes': False},
    }
)


@pytest.fixture
def intake():
    made = MeasurementIntake(CONFIG, ['top'], predict=False)
    # As of processes that are still starting.
    made.front_end.start = lambda core: Preparation(tuple((item, Future()) for item in core), 0.0)
    yield made
    made.close()


def read_until_ready(intake, points, shedding):
    """Scans until the oldest window is to be mapped, whether it is prepared or not."""
    cloud = np.random.default_rng(0).normal(scale=10.0, size=(points, 3))
    for number in range(200):
        intake.push(make_scan(10**18 + number * 10**8, 'top', cloud + number))
        if intake.ready(shedding):
            return number
    return None


@pytest.mark.parametrize('points', [4_000, 40_000])
def test_what_is_read_ahead_is_bounded_by_windows_and_by_bytes(intake, points):
    # As small clouds as KAIST's are bounded by their windows, those of many beams by their bytes.
    size = make_scan(1, 'top', np.ones((points, 3))).nbytes
    most, bound = 10 * size if points > 10_000 else MOST_BYTES, 60
    read = read_until_ready(intake, points, LoadShedding(read_ahead=bound, most_bytes=most))
    held = [window for window, _, _ in intake._held]
    assert read is not None
    assert len(held) == (12 if points > 10_000 else bound + 2)
    assert sum(window.nbytes for window in held[1:]) <= most + size
