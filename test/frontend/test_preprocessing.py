"""Points in base_link: within range, thinned, and with the motion undone."""

from dataclasses import replace

import numpy as np
import pytest
from driven_room import EPOCH, room
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from incremental_mapper.frontend.preprocessing import Sweep, Twist, deskew, to_base
from incremental_mapper.measurements import LidarScan

component = st.floats(-30.0, 30.0)


@settings(deadline=None)
@given(
    linear=st.tuples(component, component, component),
    angular=st.one_of(
        st.tuples(component, component, component),
        st.tuples(*[st.floats(-1e-9, 1e-9)] * 3),
    ),
    moment=st.floats(-0.2, 0.2),
    seed=st.integers(0, 1000),
)
def test_deskewing_is_the_rotation_and_the_translation_since_the_moment(
    linear, angular, moment, seed
):
    rng = np.random.default_rng(seed)
    rows, times = rng.uniform(-80.0, 80.0, (3, 40)), rng.uniform(-0.2, 0.2, 40)
    twist = Twist(np.array(linear), np.array(angular))
    found = deskew(Sweep(EPOCH, 'left', rows, times), twist, moment)
    since = (times - moment)[:, None]
    expected = Rotation.from_rotvec(since * twist.angular).apply(rows.T) + since * twist.linear
    assert found == pytest.approx(expected, abs=1e-9)


def test_deskewing_thinned_points_is_thinning_deskewed_ones_to_a_few_millimetres():
    rng = np.random.default_rng(3)
    # Neighbours of all times, as where a sweep's start meets its end, in a fast bend.
    points, times = room(3000).astype(np.float32), rng.uniform(-0.1, 0.0, 3000).astype(np.float32)
    twist = Twist(np.array([15.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5]))
    raw = to_base(LidarScan(EPOCH, 'left', points, times), np.eye(4), 0.0, 80.0, 1e-3)
    sweep = to_base(LidarScan(EPOCH, 'left', points, times), np.eye(4), 0.0, 80.0, 0.2)
    exact = deskew(raw, twist, 0.0)
    cells, own = np.floor(raw.rows.T / 0.2), np.floor(sweep.rows.T / 0.2)
    for cell, point in zip(own, deskew(sweep, twist, 0.0), strict=True):
        mates = exact[(cells == cell).all(axis=1)]
        if len(mates):
            assert np.linalg.norm(point - mates.mean(axis=0)) < 0.005


@pytest.mark.parametrize('with_times', [True, False])
def test_thinned_points_have_the_mean_intensity_and_are_where_they_were_without(with_times):
    rng = np.random.default_rng(5)
    points, light = room(3000).astype(np.float32), rng.uniform(0, 255, 3000).astype(np.float32)
    times = rng.uniform(-0.1, 0.0, 3000).astype(np.float32) if with_times else None
    plain = LidarScan(EPOCH, 'left', points, times)
    near, size = 2.0, 0.5
    before = to_base(plain, np.eye(4), near, 80.0, size)
    sweep = to_base(replace(plain, intensities=light), np.eye(4), near, 80.0, size)
    assert before.intensities is None and np.array_equal(before.rows, sweep.rows)
    assert (sweep.times is None) is (times is None)
    assert times is None or np.array_equal(before.times, sweep.times)
    kept = np.linalg.norm(points, axis=1) >= near
    cells = np.floor(points[kept] * np.float32(1.0 / size))
    own = np.floor(sweep.rows.T / size)
    for cell, value in list(zip(own, sweep.intensities, strict=True))[::20]:
        mates = light[kept][(cells == cell).all(axis=1)]
        if len(mates):
            assert value == pytest.approx(mates.mean(dtype=np.float64), rel=1e-6)


@pytest.mark.parametrize(
    ('times', 'middle'), [(None, 0.0), ([], 0.0), ([0.04], 0.04), ([0.0, 0.02, 0.1], 0.04)]
)
def test_middle_of_a_sweep_is_the_mean_of_its_times(times, middle):
    times = None if times is None else np.array(times)
    sweep = Sweep(EPOCH, 'left', np.zeros((3, 3 if times is None else len(times))), times)
    assert sweep.middle == pytest.approx(middle)
