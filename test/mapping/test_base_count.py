"""Whole runs on the stamps of the paper's twelve sequences: what is counted, and what connects."""

import csv
from itertools import pairwise
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from incremental_mapper.config import Strategy
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.measurements import FixStatus, GnssFix, ImuSample, LidarScan
from incremental_mapper.selection.strategies import strategy_names
from incremental_mapper.settings import make_config

STAMPS = Path(__file__).resolve().parents[3] / 'shared' / 'data' / 'kaist_timing'
SEQUENCES = [
    f'{motion}_urban-{number}'
    for motion in ('zero_speed', 'acceleration', 'constant_speed', 'deceleration')
    for number in (26, 33, 38)
]
MS = 1_000_000
SECOND = 1000 * MS
IMU_PERIOD = 10 * MS
SPEED = 1.5
"""m/s eastwards, in a walled yard."""
OTHERS = [name for name in Strategy if name != Strategy.BASE]


def yard(count=600, seed=0):
    """Points on the ground and on two walls."""
    rng = np.random.default_rng(seed)
    walls = []
    for axis, place in enumerate((-15.0, -12.0, -2.0)):
        points = rng.uniform(-20.0, 20.0, size=(count // 3, 3))
        points[:, 2] = rng.uniform(-2.0, 10.0, size=count // 3)
        points[:, axis] = place
        walls.append(points)
    return np.vstack(walls)


YARD = yard()


def imu_stamps(rows, phase):
    first = rows[0][0] // IMU_PERIOD * IMU_PERIOD + phase - 3 * IMU_PERIOD
    return list(range(first, rows[-1][0] + 3 * IMU_PERIOD, IMU_PERIOD))


def measurements(rows, imu):
    """What the sensors of a car in steady motion would see at these stamps."""
    made = [ImuSample(t, 'imu', np.zeros(3), np.array([0.0, 0.0, 9.81])) for t in imu]
    for stamp, sensor in rows:
        east = SPEED * (stamp - rows[0][0]) / SECOND
        if sensor == 'gps':
            place = pymap3d.enu2geodetic(east, 0.0, 0.0, 36.5, 127.25, 50.0)
            covariance = np.eye(3) * 0.05**2
            made.append(GnssFix(stamp, sensor, *map(float, place), FixStatus.GBAS, covariance))
        else:
            made.append(LidarScan(stamp, sensor, (YARD - [east, 0, 0]).astype(np.float32)))
    return sorted(made, key=lambda item: item.stamp)


def run(rows, imu, strategy):
    config = make_config(
        {
            'selection': {'strategy': strategy},
            'lidars': {'names': ['left', 'right']},
            'mom': {'max_points': 60},
            'graph': {'lag': 0.4, 'final_optimization': False},
        }
    )
    mapper = Mapper(config, ['left', 'right', 'gps', 'imu'])
    for item in measurements(rows, imu):
        mapper.push(item)
    return mapper.finish()


def sequence(name, limit=None):
    path = STAMPS / f'{name}.csv'
    if not path.exists():
        pytest.skip(f'{path} is absent: the stamps are not part of this project')
    with path.open(newline='') as file:
        rows = sorted((int(stamp), sensor) for stamp, sensor in list(csv.reader(file))[1:])
    return rows[:limit]


def covered_pairs(rows, imu):
    """Consecutive measurements with an IMU sample at or after the first, before the second."""
    return [
        any(first <= stamp < second for stamp in imu) for (first, _), (second, _) in pairwise(rows)
    ]


def count(rows, sensor):
    return sum(name == sensor for _, name in rows)


@pytest.mark.parametrize('name', SEQUENCES)
def test_base_graph_has_a_cluster_per_measurement_and_a_span_per_covered_pair(name):
    rows = sequence(name)
    imu = imu_stamps(rows, 3 * MS)
    result = run(rows, imu, 'base')
    stats, kinds = result.stats, result.stats['factors_by_kind']
    assert stats['clusters'] == len(rows)
    assert kinds['odometry'] == count(rows, 'left') - 1 + count(rows, 'right') - 1
    assert kinds['gnss'] == count(rows, 'gps')
    covered = covered_pairs(rows, imu)
    assert kinds['imu'] == sum(covered)
    inertial = [
        before or after for before, after in zip([False, *covered], [*covered, False], strict=True)
    ]
    assert stats['vertices'] == len(rows) + 2 * sum(inertial)
    assert stats['dropped'] == {}
    assert stats['notes'] == {}
    # Priors: the first pose, and the first velocity and bias. Where a chain of spans starts anew,
    # a bias goes on from the one before it, and a velocity too where that is not long ago.
    starts = sum(now and not before for before, now in pairwise([False, *covered]))
    assert kinds['prior_bias'] == 1
    assert kinds.get('continuity_bias', 0) == starts - 1
    assert kinds['prior_velocity'] + kinds.get('continuity_velocity', 0) == starts
    assert kinds['prior_pose'] == 1 + stats['weak_priors']
    # What is counted without building the graph is what the graph has.
    assert stats['base_clusters'] == stats['clusters']
    assert stats['base_vertices'] == stats['vertices']
    assert stats['base_factors'] == stats['factors'] - stats['weak_priors']
    assert stats['base_factors_by_kind'] == {**kinds, 'prior_pose': 1}


@pytest.mark.parametrize('name', SEQUENCES)
def test_method_counts_the_base_graph_that_the_base_strategy_builds(name):
    rows = sequence(name, limit=30)
    imu = imu_stamps(rows, 3 * MS)
    base, method = run(rows, imu, 'base').stats, run(rows, imu, 'mom').stats
    assert method['base_clusters'] == base['clusters']
    assert method['base_vertices'] == base['vertices']
    assert method['base_factors'] == base['factors'] - base['weak_priors']
    assert method['components'] == 1
    assert method['vertices'] < method['base_vertices']
    assert method['factors_by_kind']['gnss'] == count(rows, 'gps')
    assert method['factors_by_kind']['odometry'] == base['factors_by_kind']['odometry']
    assert method['unused_measurements'] == 0


@pytest.mark.parametrize('strategy', OTHERS)
@pytest.mark.parametrize(
    ('name', 'phase'), [('zero_speed_urban-33', 0), ('constant_speed_urban-38', 7 * MS)]
)
def test_graph_of_every_other_strategy_is_connected(name, strategy, phase):
    rows = sequence(name, limit=30)
    result = run(rows, imu_stamps(rows, phase), strategy)
    assert result.stats['components'] == 1
    assert result.stats['weak_priors'] == 0
    assert result.stats['unused_measurements'] == 0
    used = sorted(
        (core.stamp, core.sensor) for item in result.clusters for core in item.cluster.members
    )
    assert used == rows


def made_up(seconds=3.0, fix_at=(1050, 2050)):
    """Both LiDARs at 10 Hz, 8 ms apart, and fixes 4 ms after a left scan."""
    epoch = 1_544_676_777_000 * MS
    keys = [(t, 'left') for t in range(50, round(1000 * seconds), 100)]
    keys += [(t + 8, 'right') for t, _ in keys]
    keys += [(t + 4, 'gps') for t in fix_at]
    return [(epoch + t * MS, name) for t, name in sorted(keys)]


def test_fix_without_imu_sample_around_it_is_loose_in_the_base_graph_and_used_by_the_method():
    rows = made_up()
    imu = imu_stamps(rows, 9 * MS)  # at 9, 19, ... ms: none from a left scan to the right one
    assert not any(stamp // MS % 100 in range(50, 58) for stamp in imu)
    base = run(rows, imu, 'base').stats
    # Where the right scan follows without a sample, nothing but its own prior holds the fix.
    assert base['components'] == 3
    assert base['weak_priors'] >= 2
    method = run(rows, imu, 'mom')
    assert method.stats['components'] == 1
    fixes = [factor for factor in method.factors if str(factor.kind) == 'gnss']
    assert [factor.stamps[0] for factor in fixes] == [t for t, name in rows if name == 'gps']


def test_gap_in_the_imu_leaves_the_graph_of_the_method_connected():
    rows = made_up()
    start = rows[0][0]
    imu = [t for t in imu_stamps(rows, 3 * MS) if not 0.8 < (t - start) / SECOND < 1.4]
    for strategy in ('mom', 'min_time_shift'):
        stats = run(rows, imu, strategy).stats
        assert stats['components'] == 1
        assert stats['unused_measurements'] == 0
        assert stats['factors_by_kind']['gnss'] == 2


def test_drive_without_imu_is_mapped_by_scans_and_fixes_alone():
    rows = made_up(2.0, (1050,))
    stats = run(rows, [], 'mom').stats
    assert 'imu' not in stats['factors_by_kind']
    assert stats['components'] == 1
    assert stats['base_vertices'] == len(rows)


@pytest.mark.parametrize('strategy', OTHERS)
def test_first_window_that_can_only_be_bridged_leaves_the_graph_connected(strategy):
    # No IMU, and scans too small to match: two of one LiDAR can neither merge nor be linked.
    epoch = 1_544_676_777_000 * MS
    config = make_config(
        {
            'selection': {'strategy': strategy},
            'lidars': {'names': ['left']},
            'window': {'duration': 0.25, 'max_carry': 0.0},
        }
    )
    mapper = Mapper(config, ['left'])
    for i in range(8):
        points = YARD[20 * i : 20 * i + 20].astype(np.float32)
        mapper.push(LidarScan(epoch + 100 * i * MS, 'left', points))
    stats = mapper.finish().stats
    assert stats['unused_measurements'] == 0
    # The map begins with a guess; later ones would hold nothing but what they guess.
    assert stats['clusters'] == 3
    assert stats['bridges'] == 2
    assert stats['dropped'] == {'left': {'unmatched': 5}}
    assert stats['components'] == 1


@pytest.mark.parametrize('strategy', OTHERS)
def test_fixes_before_the_first_scan_are_mapped(strategy):
    rows = made_up(2.0, (1050,))
    first = rows[0][0]
    rows = [(first - t * MS, 'gps') for t in (450, 300, 150)] + rows
    stats = run(rows, imu_stamps(rows, 3 * MS), strategy).stats
    assert stats['factors_by_kind']['gnss'] == 4
    assert stats['components'] == 1


def test_scan_too_small_to_match_loses_no_odometry_but_its_own():
    rows = made_up(2.0, ())
    imu = imu_stamps(rows, 3 * MS)
    small = rows[16]
    config = make_config(
        {'selection': {'strategy': 'base'}, 'lidars': {'names': ['left', 'right']}}
    )
    mapper = Mapper(config, ['left', 'right', 'imu'])
    for item in measurements(rows, imu):
        tiny = (item.stamp, item.sensor) == small
        mapper.push(LidarScan(*small, YARD[:20].astype(np.float32)) if tiny else item)
    stats = mapper.finish().stats
    assert stats['notes'] == {f'{small[1]}: too few points to match': 1}
    matched = len(rows) - 2 - 1  # all but the first scan of each LiDAR and the small one
    assert stats['base_factors_by_kind']['odometry'] == matched
    assert stats['factors_by_kind']['odometry'] == matched


def test_all_strategies_of_the_paper_are_known():
    assert {str(name) for name in Strategy} <= set(strategy_names())
