"""Pieces by motion: of profiles that are known, of simulated drives, and what lies in them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from incremental_mapper.datasets.simulated.options import MotionKind, SceneKind
from incremental_mapper.datasets.simulated.scene import make_scene
from incremental_mapper.datasets.simulated.speed import make_profile
from incremental_mapper.evaluation.segments import (
    EDGE,
    SHORTEST,
    Motion,
    Segment,
    motion_of_name,
    segment_by_motion,
    segment_indices,
)
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory

START = 1_544_590_798_123_456_789
ZERO, ACCEL, CONST, DECEL = Motion


def drive(parts, rate=50.0, jitter=0.0, seed=0):
    """A trajectory along a bend; ``parts`` are seconds and the acceleration in them."""
    times = np.arange(0.0, sum(seconds for seconds, _ in parts) + 0.5 / rate, 1.0 / rate)
    ends = np.cumsum([seconds for seconds, _ in parts])
    gains = np.array([gain for _, gain in parts])
    acceleration = gains[np.minimum(np.searchsorted(ends, times, side='right'), len(parts) - 1)]
    speed = np.concatenate([[0.0], np.cumsum(acceleration[:-1] / rate)]).clip(0.0)
    way = np.concatenate([[0.0], np.cumsum(speed[:-1] / rate)])
    positions = 30.0 * np.c_[np.sin(way / 30.0), 1.0 - np.cos(way / 30.0), np.zeros(len(way))]
    positions += np.random.default_rng(seed).normal(0.0, jitter, positions.shape)
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1))
    stamps = START + np.round(times * NANOSECONDS).astype(np.int64)
    return Trajectory(stamps, positions, quaternions)


PROFILE = [(5.0, 0.0), (6.0, 1.0), (8.0, 0.0), (4.0, -1.5), (4.0, 0.0)]


@pytest.mark.parametrize(('rate', 'jitter'), [(100.0, 0.0), (10.0, 0.0), (20.0, 0.02)])
def test_known_profile_is_cut_where_the_motion_changes(rate, jitter):
    segments = segment_by_motion(drive(PROFILE, rate, jitter))
    assert [segment.motion for segment in segments] == [ZERO, ACCEL, CONST, DECEL, ZERO]
    changes = [(segment.end - START) / NANOSECONDS for segment in segments[:-1]]
    np.testing.assert_allclose(changes, [5.0, 11.0, 19.0, 23.0], atol=0.6)


def test_segments_cover_the_drive_without_gaps():
    trajectory = drive(PROFILE)
    segments = segment_by_motion(trajectory)
    assert segments[0].start == trajectory.stamps[0]
    assert segments[-1].end == trajectory.stamps[-1]
    assert all(a.end == b.start for a, b in pairwise(segments))
    assert sum(segment.seconds for segment in segments) == pytest.approx(27.0)


def test_short_change_does_not_cut_a_drive():
    parts = [(4.0, 1.5), (5.0, 0.0), (0.5, 1.0), (5.0, 0.0)]
    motions = [segment.motion for segment in segment_by_motion(drive(parts))]
    assert motions[-1] is CONST and motions.count(CONST) == 1


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.1, 4.0), st.floats(-3.0, 3.0)), min_size=1, max_size=8),
    st.integers(0, 1000),
)
def test_any_drive_is_cut_into_long_pieces_that_differ(parts, seed):
    trajectory = drive(parts, jitter=0.03, seed=seed)
    segments = segment_by_motion(trajectory)
    length = (trajectory.stamps[-1] - trajectory.stamps[0]) / NANOSECONDS
    if length < SHORTEST:
        assert segments == ()
        return
    assert segments[0].start == trajectory.stamps[0]
    assert segments[-1].end == trajectory.stamps[-1]
    for one, other in pairwise(segments):
        assert one.end == other.start
        assert one.motion is not other.motion
    if len(segments) > 1:
        # Samples stand for the time around them, those at the ends for half of it.
        assert min(segment.seconds for segment in segments) > SHORTEST - 0.11
    assert (segment_indices(trajectory.stamps, segments) >= 0).all()


@pytest.mark.parametrize('count', [0, 1, 2])
def test_too_short_a_trajectory_has_no_pieces(count):
    trajectory = drive([(2.0, 0.0)])
    short = Trajectory(
        trajectory.stamps[:count], trajectory.positions[:count], trajectory.quaternions[:count]
    )
    assert segment_by_motion(short) == ()
    assert segment_indices(trajectory.stamps, ()).tolist() == [-1] * len(trajectory)


@pytest.mark.parametrize(
    ('kind', 'motions'),
    [
        (MotionKind.ZERO, [ZERO]),
        (MotionKind.CONST, [CONST]),
        (MotionKind.ACCEL, [ZERO, ACCEL, CONST]),
        (MotionKind.DECEL, [CONST, DECEL, ZERO]),
    ],
)
def test_simulated_motions_are_recognised(kind, motions):
    route = make_scene(SceneKind.STREET, 0).route
    profile = make_profile(kind, 20.0, route, np.random.default_rng(1))
    times = np.arange(0.0, 20.0, 0.02)
    arc, _, _ = profile(times)
    positions = np.c_[arc, np.zeros((len(arc), 2))]
    stamps = START + np.round(times * NANOSECONDS).astype(np.int64)
    trajectory = Trajectory(stamps, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))
    found = [segment.motion for segment in segment_by_motion(trajectory)]
    assert found == motions


def test_stamps_fall_into_the_piece_that_holds_them():
    segments = (
        Segment(ZERO, START, START + 10 * NANOSECONDS),
        Segment(ACCEL, START + 10 * NANOSECONDS, START + 20 * NANOSECONDS),
    )
    edge = round(EDGE * NANOSECONDS)
    stamps = np.array(
        [
            START - edge - 1,
            START - edge,
            START,
            START + 10 * NANOSECONDS - 1,
            START + 10 * NANOSECONDS,
            START + 20 * NANOSECONDS + edge,
            START + 20 * NANOSECONDS + edge + 1,
        ]
    )
    assert segment_indices(stamps, segments).tolist() == [-1, 0, 0, 0, 1, 1, -1]


@pytest.mark.parametrize(
    ('name', 'motion', 'rest'),
    [
        ('zero_speed_urban-26', ZERO, 'urban-26'),
        ('acceleration_urban-33', ACCEL, 'urban-33'),
        ('constant_speed_x', CONST, 'x'),
        ('deceleration_', DECEL, ''),
        ('urban-26', None, 'urban-26'),
        ('zero_speed', None, 'zero_speed'),
    ],
)
def test_names_tell_motions(name, motion, rest):
    assert motion_of_name(name) == (motion, rest)
