"""Whether the vehicle stands: IMU and scan matching must both say so, for half a second."""

import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.frontend.imu_preintegration import ImuSeries
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.mapping.standstill import DRIFT, WANDER, Standstill

MS = 1_000_000
NO_BIAS = gtsam.imuBias.ConstantBias()
NO_POINTS = np.zeros((0, 3))
STEP = 100 * MS


def imu(start, rate=(0.0, 0.0, 0.0), shaking=0.05, rng=None):
    rng = np.random.default_rng(start // MS) if rng is None else rng
    stamps = np.arange(start, start + STEP, 10 * MS, dtype=np.int64)
    force = [0.0, 0.0, 9.81] + rng.normal(0.0, shaking, (len(stamps), 3))
    return ImuSeries(stamps, np.tile(rate, (len(stamps), 1)), force)


def scan(stamp, moved, matched=True, usable=True):
    motion = gtsam.Pose3(gtsam.Rot3(), np.array([moved, 0.0, 0.0])) if matched else None
    return PreparedScan(
        core=CoreMeasurement(stamp, 'top', CoreKind.LIDAR),
        thinned=NO_POINTS.astype(np.float32),
        sparse=NO_POINTS,
        previous=stamp - STEP if matched else None,
        T_previous_current=motion,
        usable=usable,
    )


def watched(windows, moved=0.0, speed=0.0, standstill=None, first=0, **of_imu):
    """What is said of so many windows of 0.1 s; ``moved`` is metres from scan to scan."""
    standstill = Standstill() if standstill is None else standstill
    said = []
    for index in range(first, first + windows):
        start = index * STEP
        item = scan(start + 90 * MS, moved)
        said.append(standstill.look([item], imu(start, **of_imu), NO_BIAS, speed))
    return said


def test_it_stands_after_half_a_second():
    said = watched(12)
    assert said.index(True) in (5, 6, 7, 8) and all(said[said.index(True) :])


@pytest.mark.parametrize(
    'what',
    [
        {'moved': 1.0},
        {'speed': 10.0},  # a tunnel whose walls all look alike: no match moves
        {'rate': (0.0, 0.0, 0.1)},
        {'shaking': 1.0},
    ],
)
def test_each_sign_of_motion_is_enough(what):
    assert not any(watched(20, **what))


def test_the_bias_of_the_gyroscope_is_no_turn():
    standstill = Standstill()
    bias = gtsam.imuBias.ConstantBias(np.zeros(3), np.array([0.0, 0.0, 0.1]))
    said = [
        standstill.look([scan(k * STEP + 90 * MS, 0.0)], imu(k * STEP, rate=(0, 0, 0.1)), bias, 0.0)
        for k in range(12)
    ]
    assert said[-1]


def test_noise_of_matches_that_cancels_is_no_motion():
    standstill = Standstill()
    errors = np.random.default_rng(1).normal(0.0, 0.005, 400)
    said = [
        watched(1, errors[k] - errors[k - 1], standstill=standstill, first=k)[0]
        for k in range(1, 400)
    ]
    assert all(said[10:])


def test_a_creeping_vehicle_comes_to_be_noticed_and_nothing_of_its_way_is_lost():
    """4 cm/s: it seems to stand, until its way shows; then the next match starts where it is."""
    standstill, way, stood, noticed = Standstill(), 0.004, 0, 0
    for k in range(1, 200):
        before = stood
        said = watched(1, way, standstill=standstill, first=k)[0]
        stood = stood + 1 if said else 0
        crept = standstill.crept.get('top')
        if crept is not None:
            noticed += 1
            assert before and not said
            matches = round(crept.x() / way) + 1
            limit = DRIFT + WANDER * np.sqrt(matches)
            assert limit - 2 * way <= crept.x() <= limit
    assert noticed > 1


def test_only_the_last_half_second_of_one_that_sets_off_is_its_way():
    """What noise has added up to in minutes at a traffic light is not."""
    standstill = Standstill()
    watched(60, 0.0015, standstill=standstill)
    assert not watched(1, 0.0, standstill=standstill, first=60, shaking=2.0)[0]
    assert standstill.crept['top'].x() == pytest.approx(4 * 0.0015)


def test_a_scan_without_a_match_tells_nothing_and_one_that_is_unusable_does_no_harm():
    standstill = Standstill()
    assert watched(12, standstill=standstill)[-1]
    start = 12 * STEP
    both = [scan(start + 40 * MS, 0.0), scan(start + 90 * MS, 0.0, matched=False, usable=False)]
    assert standstill.look(both, imu(start), NO_BIAS, 0.0)
    start += STEP
    alone = [scan(start + 90 * MS, 0.0, matched=False)]
    assert not standstill.look(alone, imu(start), NO_BIAS, 0.0)
    assert not watched(2, standstill=standstill, first=14)[-1]


def test_without_an_imu_nobody_knows():
    standstill = Standstill()
    none = ImuSeries(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    assert not any(standstill.look([scan(k * STEP, 0.0)], none, NO_BIAS, 0.0) for k in range(1, 20))
    assert not standstill.look([], none, NO_BIAS, 0.0)


@given(st.floats(0.5, 30.0), st.integers(0, 2**31))
def test_no_speed_above_a_walk_is_taken_for_standing(speed, seed):
    """Not even where the graph has lost its speed and the road is of glass."""
    rng = np.random.default_rng(seed)
    standstill = Standstill()
    for k in range(15):
        item = scan(k * STEP + 90 * MS, speed * 0.1 + rng.normal(0.0, 0.01))
        assert not standstill.look([item], imu(k * STEP, rng=rng), NO_BIAS, 0.0)
