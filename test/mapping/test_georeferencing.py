"""The local map is turned into ENU by its GNSS track, once the track says where it points."""

import gtsam
import numpy as np
import pymap3d
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import make_config
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.mapping.georeferencing import agreeing_track
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan
from incremental_mapper.selection.window_problem import fix_spread
from incremental_mapper.smoothing.graph_state import GraphState, PlacedFix

SECOND = 1_000_000_000
EPOCH = 1_544_676_777_000_000_000
ARM = np.array([-0.3, 0.4, 1.2])
DATUM = (36.5, 127.25, 50.0)
SPEED = 4.0


def square(seed=0):
    """Points on the ground and on four walls around the drive, in ENU."""
    rng = np.random.default_rng(seed)
    elements = [rng.uniform(-40, 40, size=(1200, 3)) for _ in range(5)]
    elements[0][:, 2] = -1.5
    for part, axis, place in zip(elements[1:], (0, 0, 1, 1), (-40, 40, -40, 40), strict=True):
        part[:, axis] = place
        part[:, 2] = rng.uniform(-1.5, 8, size=len(part))
    return np.vstack(elements)


SQUARE = square()


def truth(seconds, heading):
    """T_enu_base of a car that drives straight on."""
    way = np.array([np.cos(heading), np.sin(heading), 0.0]) * SPEED * seconds
    return gtsam.Pose3(gtsam.Rot3.Yaw(heading), way)


def drive(heading, seconds=3.0, orientation=None, fixes_per_second=4):
    turn = None if orientation is None else Rotation.from_euler('z', orientation).as_quat()
    made = []
    for i in range(round(seconds * 100)):
        force = np.array([0.0, 0.0, 9.81])
        made.append(ImuSample(EPOCH + i * SECOND // 100, 'imu', np.zeros(3), force, turn))
    for i in range(round(seconds * 10)):
        pose = truth(i / 10, heading)
        points = (SQUARE - pose.translation()) @ pose.rotation().matrix()
        made.append(LidarScan(EPOCH + i * SECOND // 10, 'left', points.astype(np.float32)))
    for i in range(round(seconds * fixes_per_second)):
        stamp = EPOCH + i * SECOND // fixes_per_second + 20_000_000
        antenna = truth((stamp - EPOCH) / SECOND, heading).transformFrom(ARM)
        place = map(float, pymap3d.enu2geodetic(*antenna, *DATUM))
        made.append(GnssFix(stamp, 'gps', *place, FixStatus.GBAS, np.eye(3) * 0.05**2))
    return sorted(made, key=lambda item: item.stamp)


def mapped(heading, **kwargs):
    config = make_config(
        {
            'selection': {'strategy': 'min_time_shift'},
            'lidars': {'names': ['left']},
            'gnss': {'T_base_sensor': [*ARM, 0, 0, 0, 1]},
            'graph': {'lag': 0.5},
        }
    )
    mapper = Mapper(config, ['left', 'gps', 'imu'])
    for item in drive(heading, **kwargs):
        mapper.push(item)
    return mapper.finish()


@pytest.mark.parametrize('heading', [0.0, 1.2, -2.5])
def test_map_ends_in_enu_around_the_first_antenna_position_whatever_the_heading(heading):
    result = mapped(heading)
    assert result.stats['georeferenced']
    assert result.stats['components'] == 1
    first = truth(0.02, heading).transformFrom(ARM)
    for stamp, matrix in zip(result.trajectory.stamps, result.trajectory.matrices(), strict=True):
        pose = truth((stamp - EPOCH) / SECOND, heading)
        expected = gtsam.Pose3(pose.rotation(), pose.translation() - first)
        error = expected.localCoordinates(gtsam.Pose3(matrix))
        assert np.linalg.norm(error[3:]) < 0.2
        assert np.linalg.norm(error[:3]) < 0.03
    assert result.fixes[0] == pytest.approx(np.zeros(3), abs=1e-6)


def test_heading_of_the_imu_is_corrected_by_the_track():
    result = mapped(0.8, orientation=0.3)
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    assert yaws == pytest.approx(np.full(len(yaws), 0.8), abs=0.03)


def test_short_drive_stays_in_its_local_frame():
    result = mapped(0.8, seconds=0.4, orientation=0.5)
    assert not result.stats['georeferenced']
    assert len(result.fixes) == 2
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    # Two fixes a metre apart do not overrule the heading of the IMU.
    assert (np.abs(yaws - 0.5) < np.abs(yaws - 0.8)).all()


def test_drive_without_a_fix_starts_at_the_origin_with_the_heading_of_the_imu():
    result = mapped(0.8, seconds=1.0, orientation=0.5, fixes_per_second=0)
    assert not result.stats['georeferenced']
    assert result.fixes.shape == (0, 3)
    yaws = result.trajectory.rotations().as_euler('zyx')[:, 0]
    assert yaws == pytest.approx(np.full(len(yaws), 0.5), abs=2e-3)
    assert result.trajectory.positions[0] == pytest.approx(np.zeros(3), abs=1e-6)


def placed(east, sigma=0.05):
    enu = np.array([east, 0.0, 0.0])
    return PlacedFix(0, 0, enu, np.eye(3) * sigma**2, np.zeros(3), 0)


@pytest.mark.parametrize(
    ('east', 'sigma', 'enough'),
    [
        ([0.0, 1.9], 0.05, False),
        ([0.0, 2.1], 0.05, True),
        ([0.0, 2.1, 0.1], 0.05, True),
        ([0.0, 6.0], 1.0, False),
        ([0.0, 7.5], 1.0, True),
    ],
)
def test_track_must_be_longer_than_the_setting_and_than_its_noise(east, sigma, enough):
    track = np.array([[x, 0.0, 0.0] for x in east])
    turned = track @ Rotation.from_euler('z', 1.0).as_matrix().T
    found = agreeing_track(track, turned, np.full(len(track), sigma), 2.0)
    assert (found is not None) is enough
    if enough:
        assert found.tolist() == list(range(len(track)))


@pytest.mark.parametrize('wrong', [0, 2, 4])
def test_fix_that_disagrees_with_odometry_is_not_part_of_the_track(wrong):
    local = np.array([[1.5 * i, 0.1 * i, 0.0] for i in range(5)])
    enu = local + [100.0, -30.0, 0.0]
    enu[wrong] += [0.0, 60.0, 0.0]
    found = agreeing_track(enu, local, np.full(5, 0.05), 2.0)
    assert found.tolist() == [i for i in range(5) if i != wrong]


def test_fixes_that_all_disagree_make_no_track():
    local = np.array([[1.0 * i, 0.0, 0.0] for i in range(3)])
    enu = np.array([[0.0, 0.0, 0.0], [70.0, 0.0, 0.0], [0.0, 150.0, 0.0]])
    assert agreeing_track(enu, local, np.full(3, 0.05), 2.0) is None


def test_fix_is_trusted_the_less_the_further_it_is_from_the_first_while_the_yaw_is_unknown():
    items = [
        PreparedFix(
            CoreMeasurement(stamp, 'gps', CoreKind.GNSS), np.array([east, 0.0, 9.0]), np.eye(3)
        )
        for stamp, east in ((1, 0.5), (2, 1.5))
    ]
    assert fix_spread(GraphState(), items) == {1: 0.0, 2: pytest.approx(2.0)}
    known = GraphState(fixes=[placed(0.0)])
    assert fix_spread(known, items) == {1: pytest.approx(1.0), 2: pytest.approx(3.0)}
    assert fix_spread(GraphState(georeferenced=True), items) == {}
    assert fix_spread(GraphState(), []) == {}
