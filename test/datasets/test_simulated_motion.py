"""The simulated motion, inertial samples, sweeps and fixes against the exact truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from incremental_mapper.datasets.simulated import receiver as gnss
from incremental_mapper.datasets.simulated.folder import make_drive
from incremental_mapper.datasets.simulated.imu import (
    GRAVITY,
    measured_samples,
    true_samples,
)
from incremental_mapper.datasets.simulated.lidar import COLUMNS, SPIN, TURN, Lidar, RayCaster
from incremental_mapper.datasets.simulated.options import (
    MotionKind,
    SceneKind,
    SimulationOptions,
)
from incremental_mapper.datasets.simulated.scene import make_scene
from incremental_mapper.datasets.simulated.sensors import T_BASE_IMU, T_BASE_LEFT
from incremental_mapper.datasets.simulated.speed import CRUISE
from incremental_mapper.datasets.simulated.stamps import core_stamps


def make(scene_kind, motion, duration=15.0, seed=1):
    options = SimulationOptions(scene=scene_kind, motion=motion, duration=duration, seed=seed)
    scene = make_scene(scene_kind, seed)
    return scene, make_drive(scene, options, core_stamps(options))


@pytest.mark.parametrize('kind', list(SceneKind))
def test_roads_are_closed_loops(kind):
    route = make_scene(kind, 0).route
    assert route.closing_error < 1e-6
    assert route.length > 300.0
    arcs = np.linspace(-50.0, 2.0 * route.length, 400)
    step = 1e-4
    tangent = (route.position(arcs + step) - route.position(arcs - step)) / (2.0 * step)
    heading = route.heading(arcs)
    expected = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    np.testing.assert_allclose(tangent, expected, atol=1e-6)
    bend = (route.heading(arcs + step) - route.heading(arcs - step)) / (2.0 * step)
    np.testing.assert_allclose(route.curvature(arcs), bend, atol=1e-5)


@pytest.mark.parametrize('motion', list(MotionKind))
def test_speed(motion):
    _, drive = make(SceneKind.STREET, motion)
    times = np.linspace(-0.3, 15.3, 2000)
    speed = drive.speed(times)
    position = drive.poses(times)[0]
    travelled = np.linalg.norm(np.diff(position[:, :2], axis=0), axis=1)
    np.testing.assert_allclose(
        travelled, (speed[1:] + speed[:-1]) / 2.0 * np.diff(times), rtol=1e-3, atol=1e-6
    )
    start, end = speed[0], speed[-1]
    expected = {
        MotionKind.ZERO: (0.0, 0.0),
        MotionKind.ACCEL: (0.0, CRUISE),
        MotionKind.CONST: (CRUISE, CRUISE),
        MotionKind.DECEL: (22.0 / 3.6, 0.0),
        MotionKind.MIXED: (0.0, 0.0),
    }[motion]
    assert (start, end) == pytest.approx(expected, abs=1e-9)
    assert speed.max() <= 30.0 / 3.6 + 1e-9


@pytest.mark.parametrize('kind', list(SceneKind))
def test_mixed_motion_stops_and_turns(kind):
    _, drive = make(kind, MotionKind.MIXED, duration=60.0)
    times = np.arange(0.0, 60.0, 0.01)
    samples = true_samples(drive, times)
    assert np.abs(samples.force[:, :2]).max() < 5.0
    assert np.abs(np.diff(samples.force, axis=0)).max() < 0.4
    assert np.abs(np.diff(samples.gyro, axis=0)).max() < 0.02
    speed = drive.speed(times)
    standing = speed < 1e-6
    assert 0.02 < standing.mean() < 0.5 and speed.max() > 5.5
    heading = np.unwrap(drive.poses(times)[1].as_euler('ZYX')[:, 0])
    assert np.ptp(heading) > np.radians(80.0)


@pytest.mark.parametrize('motion', [MotionKind.MIXED, MotionKind.DECEL])
def test_dead_reckoning_returns_the_truth(motion):
    _, drive = make(SceneKind.STREET, motion)
    rate = 400.0
    middles = (np.arange(int(12.0 * rate)) + 0.5) / rate
    samples = true_samples(drive, middles)
    ends = np.array([0.0, 12.0])
    position, rotation = drive.poses(ends)
    imu = position + rotation.apply(np.tile(T_BASE_IMU[:3, 3], (2, 1)))
    after = drive.poses(np.array([1e-4, -1e-4]))
    tips = after[0] + after[1].apply(np.tile(T_BASE_IMU[:3, 3], (2, 1)))
    velocity = (tips[0] - tips[1]) / 2e-4
    turn, place, step = rotation[0], imu[0], 1.0 / rate
    for gyro, force in zip(samples.gyro, samples.force, strict=True):
        halfway = turn * Rotation.from_rotvec(gyro * step / 2.0)
        acceleration = halfway.apply(force) - [0.0, 0.0, GRAVITY]
        place = place + velocity * step + acceleration * step**2 / 2.0
        velocity = velocity + acceleration * step
        turn = turn * Rotation.from_rotvec(gyro * step)
    np.testing.assert_allclose(place, imu[1], atol=0.01)
    assert (turn.inv() * rotation[1]).magnitude() < 1e-4


def test_standing_imu_feels_gravity_and_noise():
    _, drive = make(SceneKind.STREET, MotionKind.ZERO)
    times = np.arange(0.0, 15.0, 0.01)
    exact = true_samples(drive, times)
    np.testing.assert_allclose(np.linalg.norm(exact.force, axis=1), GRAVITY, atol=1e-5)
    np.testing.assert_allclose(exact.gyro, 0.0, atol=1e-9)
    chunks = list(measured_samples(drive, times, np.random.default_rng(0)))
    gyro = np.concatenate([chunk.gyro for chunk in chunks])
    force = np.concatenate([chunk.force for chunk in chunks])
    assert gyro.std(axis=0) == pytest.approx([0.005] * 3, rel=0.1)
    assert force.std(axis=0) == pytest.approx([0.015] * 3, rel=0.1)
    error = (chunks[0].attitude * exact.attitude[:1000].inv()).magnitude()
    assert 0.0 < error.max() < 0.3


def near_mesh(caster, points, limit):
    """Which points (N, 3) lie within ``limit`` metres of the mesh along one of 26 directions."""
    steps = np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T.astype(float)
    steps = steps[np.abs(steps).sum(axis=1) > 0]
    near = np.zeros(len(points), dtype=bool)
    for direction in steps / np.linalg.norm(steps, axis=1, keepdims=True):
        near |= caster.cast(points, np.tile(direction, (len(points), 1)))[0] < limit
    return near


@pytest.mark.parametrize('kind', [SceneKind.STREET, SceneKind.CURVE])
def test_points_lie_on_the_scene(kind):
    pytest.importorskip('embreex', reason='embreex is not installed (extra "sim")')
    scene, drive = make(kind, MotionKind.CONST)
    caster = RayCaster(scene.mesh)
    phase, end = 1.0, 4.0
    lidar = Lidar(caster, drive, T_BASE_LEFT, phase)
    points = lidar.sweep(end, np.random.default_rng(0))[:, :3].astype(float)
    # The azimuth says when a point was fired, up to whole turns of the head.
    azimuth = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
    last = phase - SPIN * end
    turns = np.round((azimuth[-1] - last) / (2.0 * np.pi))
    times = (phase - azimuth + 2.0 * np.pi * turns) / SPIN
    assert end - TURN < times.min() and times.max() <= end + TURN / COLUMNS

    def world(at):
        position, rotation = drive.poses(at)
        base = points @ T_BASE_LEFT[:3, :3].T + T_BASE_LEFT[:3, 3]
        return position + rotation.apply(base)

    undistorted = world(times)
    assert near_mesh(caster, undistorted, 0.1).mean() > 0.995
    upright = undistorted[:, 2] > 0.6
    distorted = world(np.full(len(points), end))
    assert near_mesh(caster, distorted[upright], 0.1).mean() < 0.9


def test_spells_of_poor_reception():
    rng = np.random.default_rng(0)
    assert gnss.make_spells(20.0, rng) == []
    spells = gnss.make_spells(120.0, rng)
    assert {spell.state for spell in spells} == set(gnss.FixState) - {gnss.FixState.FIXED}
    _, drive = make(SceneKind.FIELD, MotionKind.MIXED, duration=120.0)
    times = np.arange(0.0, 120.0, 0.2)
    found = list(gnss.fixes(drive, times, spells, rng))
    assert len(found) < len(times)
    antenna = gnss.antenna_positions(drive, times)
    for state in (gnss.FixState.FIXED, gnss.FixState.FLOAT, gnss.FixState.SINGLE):
        error = [fix.position - antenna[fix.index] for fix in found if fix.state is state]
        spread = np.sqrt(np.mean(np.square(error), axis=0))
        assert np.all(spread < 2.2 * gnss.SIGMA[state] * gnss.VERTICAL)
        assert np.all(spread > 0.3 * gnss.SIGMA[state])
