"""Odometry that others can use: twist, continuous frame, pose between windows, datum."""

import functools
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gtsam
import numpy as np
import pymap3d
from nav_msgs.msg import Odometry
from node_runs import SEED, Drive, node_run
from numpy.typing import NDArray

from incremental_mapper.cli.convert import convert
from incremental_mapper.config import Sensor, Tree
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.datasets.truth import find_truth
from incremental_mapper.geometry import matrix_numbers
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.odometry_frame import OdometryFrame
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.measurements import NANOSECONDS, GnssFix, Measurement
from incremental_mapper.results.opened_drive import effective_config
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.ros.publishers import reliable
from incremental_mapper.settings import merge, read_yaml
from incremental_mapper.trajectory import Trajectory
from robot_rows import Seen, row

SECONDS = 15.0
CONFIG = Path(__file__).parents[2] / 'config' / 'kaist.yaml'
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """What a node published of a drive, and the truth of it."""

    truth: Trajectory
    heard: dict[str, list[Odometry]]
    parts: dict[str, dict[str, Any]]


@functools.cache
def scratch() -> TemporaryDirectory[str]:
    """A folder that all rows of this file share; it goes with the program."""
    return TemporaryDirectory(prefix='robot_odometry_')


@functools.cache
def driven() -> Path:
    """A simulated drive that speeds up, stands and turns, as a folder of KAIST."""
    folder = Path(scratch().name) / 'drive'
    simulate(folder, SimulationOptions(motion=MotionKind.MIXED, duration=SECONDS, seed=SEED), None)
    return folder


@functools.cache
def played() -> Played:
    """The drive through DDS and a node, in real time."""
    bag = Path(scratch().name) / 'bag'
    convert(driven(), bag)
    info = open_source(bag, read_yaml(CONFIG)).info
    drive = Drive(bag, (bag / SETTINGS_FILE, CONFIG), dict(info.counts), info.duration)
    heard: dict[str, list[Odometry]] = {name: [] for name in ('odometry', 'odom', 'odometry_imu')}
    log = Path(scratch().name) / 'node.log'
    with node_run(drive, log, {'imu_odometry.publish': True}) as run:
        for name, kept in heard.items():

            def take(message: Any, kept: list[Odometry] = kept) -> None:
                kept.append(message.message)

            run.client.listen(f'/incremental_mapper/{name}', Odometry, take, reliable(1000))
        run.play(1.0)
        parts = run.parts()  # before flush, when nothing more comes
        run.catch_up()
        run.client.call('flush')
        run.parts()
    return Played(truth_of(driven()), heard, parts)


def truth_of(folder: Path) -> Trajectory:
    """The truth beside a drive."""
    truth = find_truth([folder])
    assert truth is not None
    return truth


def covered(messages: list[Odometry], truth: Trajectory, margin: float = 0.1) -> list[Odometry]:
    """Those that the truth reaches beyond, by some seconds."""
    aside = round(margin * NANOSECONDS)
    first, last = int(truth.stamps[0]) + aside, int(truth.stamps[-1]) - aside
    return [message for message in messages if first <= stamp_of(message) <= last]


def stamp_of(message: Odometry) -> int:
    """A header's stamp in nanoseconds."""
    return int(message.header.stamp.sec) * NANOSECONDS + int(message.header.stamp.nanosec)


def pose_of(message: Odometry) -> gtsam.Pose3:
    """The pose of a message."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    rotation = gtsam.Rot3.Quaternion(turn.w, turn.x, turn.y, turn.z)
    return gtsam.Pose3(rotation, np.array([place.x, place.y, place.z]))


def true_poses(truth: Trajectory, stamps: list[int]) -> list[gtsam.Pose3]:
    """T_world_base at stamps."""
    return [
        gtsam.Pose3(matrix)
        for matrix in truth.interpolate(np.array(stamps, dtype=np.int64)).matrices()
    ]


def true_twists(
    truth: Trajectory, stamps: list[int], T_car_base: gtsam.Pose3 | None = None
) -> Array:
    """Linear and angular velocity in base_link (N, 6), by the truth 50 ms before and after.

    Where base_link is not the frame of the truth, ``T_car_base`` tells where it is in that.
    """
    half, base = NANOSECONDS // 20, T_car_base or gtsam.Pose3()
    before = true_poses(truth, [stamp - half for stamp in stamps])
    after = true_poses(truth, [stamp + half for stamp in stamps])
    steps = [base.between(a.between(b).compose(base)) for a, b in zip(before, after, strict=True)]
    logs = np.array([gtsam.Pose3.Logmap(step) for step in steps])
    return np.hstack([logs[:, 3:], logs[:, :3]]) / 0.1


def twists_of(messages: list[Odometry]) -> tuple[Array, Array]:
    """Twists (N, 6) and their covariances (N, 6, 6)."""
    twists = [
        [
            *(
                getattr(part, axis)
                for part in (m.twist.twist.linear, m.twist.twist.angular)
                for axis in 'xyz'
            )
        ]
        for m in messages
    ]
    return np.array(twists), np.array([m.twist.covariance for m in messages]).reshape(-1, 6, 6)


def step_errors(truth: Trajectory, stamps: list[int], poses: list[gtsam.Pose3]) -> Array:
    """By how much each step from pose to pose is off, metres."""
    exact = true_poses(truth, stamps)
    return np.array(
        [
            np.linalg.norm(
                exact[i].between(exact[i + 1]).between(poses[i].between(poses[i + 1])).translation()
            )
            for i in range(len(poses) - 1)
        ]
    )


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


@row('angular 0, all variances 1e6')
def twist(folder: Path) -> Seen:
    """Twist of ~/odometry against the truth, 15 s of driving in real time."""
    run = played()
    # Until the graph has seen the car move it knows no velocity, and says so.
    messages = [
        message
        for message in covered(run.heard['odometry'], run.truth)
        if message.twist.covariance[0] < 0.25
    ]
    found, covariances = twists_of(messages)
    off = found - true_twists(run.truth, [stamp_of(message) for message in messages])
    scaled = {
        name: float(
            np.mean(
                [
                    e @ np.linalg.solve(c, e) / 3.0
                    for e, c in zip(off[:, part], covariances[:, part, part], strict=True)
                ]
            )
        )
        for name, part in (('velocity', slice(0, 3)), ('rate', slice(3, 6)))
    }
    velocity, rate = rms(off[:, :3]), rms(off[:, 3:])
    share = len(messages) / len(covered(run.heard['odometry'], run.truth))
    ok = share > 0.9 and velocity < 0.2 and rate < 0.03 and max(scaled.values()) < 3.0
    return Seen(
        f'velocity off by {velocity:.3f} m/s rms, rate by {rate:.4f} rad/s rms; mean squares of '
        f'the errors over their variances {scaled["velocity"]:.2f} and {scaled["rate"]:.2f} '
        f'(1 is right); known in {share:.0%} of {len(covered(run.heard["odometry"], run.truth))}',
        ok,
    )


@row('no ~/odom')
def continuity(folder: Path) -> Seen:
    """Largest jump of ~/odom and of ~/odometry against the truth, 15 s in real time."""
    run = played()
    jumps = {}
    for name in ('odom', 'odometry'):
        messages = covered(run.heard[name], run.truth)
        stamps = [stamp_of(message) for message in messages]
        jumps[name] = step_errors(run.truth, stamps, [pose_of(m) for m in messages])
    odom, odometry = (float(jumps[name].max()) for name in ('odom', 'odometry'))
    return Seen(
        f'{odom:.3f} m from window to window in odom ({rms(jumps["odom"]):.3f} m rms), '
        f'{odometry:.2f} m in the map, which becomes ENU meanwhile',
        odom < 0.1,
    )


@row('no ~/odom')
def jumping_fixes(folder: Path) -> Seen:
    """The same where every other fix is moved by 1 m."""
    truth = truth_of(driven())
    largest = {}
    for shift in (0.0, 1.0):
        moved = (_moved(item, shift * (number % 2)) for number, item in _numbered_fixes())
        stamps, in_map, in_odom = _followed(moved)
        inside = [
            i for i, stamp in enumerate(stamps) if truth.stamps[0] <= stamp <= truth.stamps[-1]
        ]
        known = [stamps[i] for i in inside]
        largest[shift] = [
            float(step_errors(truth, known, [poses[i] for i in inside]).max())
            for poses in (in_odom, in_map)
        ]
    return Seen(
        f'{largest[1.0][0]:.3f} m in odom ({largest[0.0][0]:.3f} m without), '
        f'{largest[1.0][1]:.2f} m in the map',
        largest[1.0][0] < 0.1,
    )


@row('nothing between two windows')
def between_windows(folder: Path) -> Seen:
    """~/odometry_imu: rate, and error since the window it starts from, 15 s in real time."""
    run = played()
    windows = covered(run.heard['odom'], run.truth)
    at = {stamp_of(message): pose_of(message) for message in windows}
    messages = covered(run.heard['odometry_imu'], run.truth)
    starts = np.array(sorted(at), dtype=np.int64)
    stamps = [stamp_of(message) for message in messages]
    # Against the next pose of ~/odom at the same time, which the prediction did not know.
    ends = true_poses(run.truth, stamps)
    off = []
    for stamp, exact, message in zip(stamps, ends, messages, strict=True):
        nearest = int(starts[np.abs(starts - stamp).argmin()])
        if abs(nearest - stamp) < NANOSECONDS // 10:
            base = true_poses(run.truth, [nearest])[0]
            predicted = at[nearest].between(pose_of(message))
            off.append(float(np.linalg.norm(base.between(exact).between(predicted).translation())))
    span = (stamps[-1] - stamps[0]) / NANOSECONDS if stamps else 0.0
    rate = (len(stamps) - 1) / max(span, 1e-3)
    part = run.parts['odometry_imu']
    lasted = span / SECONDS
    ok = rate > 95.0 and lasted > 0.5 and np.max(off) < 0.3 and part['largest_correction_m'] < 0.3
    return Seen(
        f'{rate:.0f} Hz over {span:.0f} s; off by {rms(np.array(off)):.3f} m rms, '
        f'{np.max(off):.3f} m at most; a window moved it by at most '
        f'{part["largest_correction_m"]:.3f} m',
        bool(ok),
    )


@row('every session has the origin of its first fix')
def shared_datum(folder: Path) -> Seen:
    """Two sessions of one street, the second begins 6 s later, with and without a datum."""
    source = open_source(driven(), read_yaml(CONFIG))
    first = next(item for item in source.measurements() if isinstance(item, GnssFix))
    place = pymap3d.enu2geodetic(
        400.0, -300.0, 0.0, first.latitude, first.longitude, first.altitude
    )
    names = ('latitude', 'longitude', 'altitude')
    datum = {'fixed': True, **dict(zip(names, map(float, place), strict=True))}
    truth = truth_of(driven())
    apart, errors = [], []
    for settings in ({}, {'datum': datum}):
        maps = [_mapped(settings, begin) for begin in (0.0, 6.0)]
        errors = [trajectory_errors(one.trajectory, truth).ate_rmse_m for one in maps]
        ours, theirs = (
            dict(zip(m.trajectory.stamps.tolist(), m.trajectory.positions, strict=True))
            for m in maps
        )
        shared = sorted(ours.keys() & theirs.keys())
        apart.append(rms(np.array([np.linalg.norm(ours[i] - theirs[i]) for i in shared])))
    return Seen(
        f'{apart[1]:.3f} m rms apart with a datum, {apart[0]:.2f} m without; ATE {errors[0]:.3f} m '
        f'and {errors[1]:.3f} m',
        apart[1] < max(2.0 * max(errors), 0.1) < apart[0],
    )


@row('not tried')
def other_base(folder: Path) -> Seen:
    """Twist of a base 2.3 m off the car's, turned by 90 and 20 degrees, and with it all sensors."""
    T_car_base = gtsam.Pose3(gtsam.Rot3.Ypr(np.pi / 2, 0.0, 0.35), np.array([2.0, -1.0, 0.5]))
    tree = read_yaml(CONFIG)
    config = effective_config(open_source(driven(), tree), tree, 'robot.py')
    inverse = T_car_base.inverse().matrix()

    def place(sensor: Sensor) -> Tree:
        return {'T_base_sensor': matrix_numbers(inverse @ sensor.matrix())}

    moved: Tree = {'imu': place(config.imu), 'gnss': place(config.gnss)}
    moved['lidars'] = {name: place(lidar) for name, lidar in config.lidars.items()}
    truth, aside = truth_of(driven()), NANOSECONDS // 10
    found, stamps = [], []
    with closing(_mapper(moved)) as mapper:
        for item in open_source(driven(), merge(tree, moved)).measurements():
            for window in mapper.advance(item):
                newest = mapper.newest() if window.clusters else None
                if newest is None or newest.velocity_covariance is None or newest.rate is None:
                    continue
                if truth.stamps[0] + aside <= newest.stamp <= truth.stamps[-1] - aside:
                    stamps.append(newest.stamp)
                    velocity = newest.pose.rotation().unrotate(newest.velocity)
                    found.append(np.hstack([velocity, newest.rate]))
    off = np.array(found) - true_twists(truth, stamps, T_car_base)
    velocity, rate = rms(off[:, :3]), rms(off[:, 3:])
    return Seen(
        f'velocity off by {velocity:.3f} m/s rms, rate by {rate:.4f} rad/s rms, in {len(found)} '
        f'windows; the car goes {rms(true_twists(truth, stamps, T_car_base)[:, :3]):.1f} m/s along '
        'y and z of it',
        velocity < 0.2 and rate < 0.03 and len(found) > 100,
    )


def _numbered_fixes() -> Iterator[tuple[int, Measurement]]:
    """Measurements of the drive, each with the number of fixes before it."""
    number = 0
    for item in open_source(driven(), read_yaml(CONFIG)).measurements():
        yield number, item
        number += isinstance(item, GnssFix)


def _moved(item: Measurement, metres: float) -> Measurement:
    if not isinstance(item, GnssFix) or metres == 0.0:
        return item
    shift = metres / np.sqrt(2.0)
    place = pymap3d.enu2geodetic(shift, shift, 0.0, item.latitude, item.longitude, item.altitude)
    return replace(item, latitude=float(place[0]), longitude=float(place[1]))


def _mapper(settings: Tree) -> Mapper:
    tree = merge(read_yaml(CONFIG), settings)
    source = open_source(driven(), tree)
    config = effective_config(source, tree, 'robot.py')
    return Mapper(config, [name for name, count in source.info.counts.items() if count])


def _followed(
    measurements: Iterator[Measurement],
) -> tuple[list[int], list[gtsam.Pose3], list[gtsam.Pose3]]:
    """Stamps of the newest states, and their poses in the map and in odom."""
    stamps: list[int] = []
    in_map: list[gtsam.Pose3] = []
    in_odom: list[gtsam.Pose3] = []
    with closing(_mapper({})) as mapper:
        frame = OdometryFrame(mapper.config.odometry)
        for item in measurements:
            for window in mapper.advance(item):
                newest = mapper.newest() if window.clusters else None
                if newest is not None:
                    stamps.append(newest.stamp)
                    in_map.append(newest.pose)
                    in_odom.append(frame.follow(mapper.state, newest).pose)
    return stamps, in_map, in_odom


def _mapped(settings: Tree, begin: float) -> MapResult:
    """The map of the drive from so many seconds on."""
    with closing(_mapper(settings)) as mapper:
        first: int | None = None
        for item in open_source(driven(), merge(read_yaml(CONFIG), settings)).measurements():
            first = item.stamp if first is None else first
            if item.stamp >= first + begin * NANOSECONDS:
                mapper.push(item)
        return mapper.finish()
