"""A car on a steady bend: where it is at every stamp, and windows of what its sensors measured.

G(t-1) is one cluster, which knows all of it; nothing has any noise. So whatever is made of a
window must agree with the truth, however its measurements are merged and connected.
"""

import gtsam
import numpy as np
from hypothesis import strategies as st

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.frontend.front_end import PreparedFix
from incremental_mapper.frontend.imu_preintegration import ImuSeries, preintegration_parameters
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.geometry import transform_points
from incremental_mapper.graph.factors import bias_prior, pose_prior, pose_sigmas, velocity_prior
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.selection.window_problem import pose_problem
from incremental_mapper.settings import make_config
from incremental_mapper.smoothing.graph_state import GraphState, PlacedCluster, PlacedScan
from incremental_mapper.smoothing.marginal_prior import MarginalPrior
from incremental_mapper.smoothing.smoother import smoother_update
from incremental_mapper.variables import bias_key, pose_key, velocity_key

MS = 1_000_000
TURN = np.array([0.0, 0.0, 0.8])
"""Angular velocity in base_link, rad/s."""
SPEED = np.array([12.0, 1.0, 0.0])
"""Velocity in base_link, m/s."""
START = gtsam.Pose3(gtsam.Rot3.Yaw(0.7), np.array([40.0, -25.0, 3.0]))
ARM = np.array([-0.3, 0.8, 1.2])
"""The antenna in base_link."""
ENU_OFFSET = np.array([30.0, -20.0, 1.0])
"""Where ENU's origin lies in the map."""
LANDMARKS = np.random.default_rng(0).uniform(-30.0, 30.0, size=(60, 3)) + START.translation()
CHAINS = {'left': 0, 'right': -30 * MS}
"""Stamps of the LiDARs' last scans, which are in the cluster of G(t-1)."""


def truth(stamp):
    """T_map_base at a stamp (ns)."""
    return START.compose(gtsam.Pose3.Expmap(np.concatenate([TURN, SPEED]) * (stamp / 1e9)))


def velocity(stamp):
    """Velocity (3,) in the map, m/s."""
    return truth(stamp).rotation().rotate(SPEED)


def motion(start, end):
    """T_start_end."""
    return truth(start).between(truth(end))


def settings(**sections):
    tree = {
        'gnss': {'T_base_sensor': [*ARM, 0, 0, 0, 1]},
        'graph': {'motion_compensation': True, 'max_iterations': 30},
        'fixes': {'robust_threshold': 0.0},
    }
    for name, section in sections.items():
        tree[name] = {**tree.get(name, {}), **section}
    return make_config(tree)


def own_biases(**sections):
    """As ``settings``, with a bias at each end of a span."""
    graph = sections.pop('graph', {})
    return settings(graph={**graph, 'bias_period': 0.0}, **sections)


def imu_series(first, last, step=2 * MS):
    """What a perfect IMU in base_link measures from ``first`` to ``last``."""
    stamps = np.arange(first, last, step, dtype=np.int64)
    force = np.cross(TURN, SPEED) + [0.0, 0.0, 9.81]
    return ImuSeries(stamps, np.tile(TURN, (len(stamps), 1)), np.tile(force, (len(stamps), 1)))


def scan(stamp, sensor='left', previous=None, usable=True):
    """A scan that sees all landmarks, and its odometry since ``previous``."""
    points = transform_points(truth(stamp).inverse().matrix(), LANDMARKS)
    return PreparedScan(
        core=CoreMeasurement(stamp, sensor, CoreKind.LIDAR),
        thinned=points.astype(np.float32),
        sparse=points,
        previous=previous,
        T_previous_current=None if previous is None else motion(previous, stamp),
        usable=usable,
    )


def fix(stamp, sigma=0.05):
    """A fix of the antenna, of another precision along each axis."""
    antenna = truth(stamp).transformFrom(ARM)
    core = CoreMeasurement(stamp, 'gps', CoreKind.GNSS)
    return PreparedFix(core, antenna - ENU_OFFSET, np.diag([1.0, 4.0, 9.0]) * sigma**2)


def items_at(stamps):
    """Prepared measurements in time order, by the sensors of each stamp (ns)."""
    last, items = dict(CHAINS), []
    for stamp in sorted(stamps):
        for sensor in sorted(stamps[stamp]):
            if sensor == 'gps':
                items.append(fix(stamp))
            else:
                items.append(scan(stamp, sensor, last[sensor]))
                last[sensor] = stamp
    return items


@st.composite
def windows(draw, most=5):
    """Stamps of a window (ns) with the sensors that measure then."""
    moments = draw(st.sets(st.integers(1, 30), min_size=1, max_size=most))
    sensors = st.sets(st.sampled_from(['left', 'right', 'gps']), min_size=1, max_size=2)
    return {moment * 10 * MS + MS: draw(sensors) for moment in moments}


def known_state(head_inertial=True, sigma=1e-3):
    """G(t-1): one cluster at stamp 0 that holds the last scan of each LiDAR."""
    config = settings()
    values = gtsam.Values()
    values.insert(pose_key(0), truth(0))
    factors = [pose_prior(pose_key(0), truth(0), pose_sigmas(sigma, sigma / 10.0), 0)]
    if head_inertial:
        values.insert(velocity_key(0), velocity(0))
        values.insert(bias_key(0), gtsam.imuBias.ConstantBias())
        factors.append(velocity_prior(velocity_key(0), velocity(0), sigma, 0))
        bias = gtsam.imuBias.ConstantBias()
        factors.append(bias_prior(bias_key(0), bias, config.graph, 0))
    plain = [factor.factor for factor in factors]
    prior, _ = smoother_update(MarginalPrior(), plain, values, {0: 0}, 10)
    state = GraphState()
    items = [scan(stamp, sensor) for sensor, stamp in CHAINS.items()]
    members = tuple(sorted(item.core for item in items))
    scans = [
        (
            PlacedScan(
                0,
                item.core.stamp,
                item.core.sensor,
                state.store.put(item.thinned),
                motion(0, item.core.stamp),
            ),
            item.sparse,
        )
        for item in items
    ]
    state.add_clusters([PlacedCluster(0, 0, Cluster(members))], scans, [])
    state.add_factors(factors, prior)
    frontier = Frontier(
        chains={sensor: (0, stamp) for sensor, stamp in CHAINS.items()},
        head=0,
        head_stamp=0,
        head_inertial=head_inertial,
        inertial=0 if head_inertial else None,
        inertial_stamp=0,
        newest=0,
        newest_stamp=0,
        bias=0 if head_inertial else None,
    )
    state.advance(frontier, velocity(0), -(10**12))
    state.define_enu(ENU_OFFSET)
    return state


def problem_of(stamps, state=None, config=None, series=None, limit=None):
    """The problem of a window with these measurements, behind ``known_state``."""
    config = settings() if config is None else config
    state = known_state() if state is None else state
    series = imu_series(-50 * MS + 300_000, max(stamps) + 50 * MS) if series is None else series
    parameters = preintegration_parameters(config.preintegration, config.imu.matrix())
    return pose_problem(items_at(stamps), state, series, None, parameters, config, limit)


def true_values(candidate, problem):
    """The truth for every variable that a candidate's factors may touch."""
    values = gtsam.Values()
    known = {problem.partitions.number(item): item.stamp for item in candidate.clusters}
    for number, stamp in {0: 0, **known}.items():
        values.insert(pose_key(number), truth(stamp))
        values.insert(velocity_key(number), velocity(stamp))
        values.insert(bias_key(number), gtsam.imuBias.ConstantBias())
    return values


def assert_poses(found, expected, metres=2e-3, radians=1e-4):
    """Whether two poses are the same but for what the integration of the IMU leaves."""
    apart = expected.localCoordinates(found)
    assert np.abs(apart[3:]).max() < metres
    assert np.abs(apart[:3]).max() < radians
