"""A map is judged by its factors, whole and while it grows."""

import logging
import weakref
from collections import deque
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.checks.finding import Severity
from incremental_mapper.config import Config, ImuSettings
from incremental_mapper.frontend.imu_preintegration import (
    ImuSeries,
    integrate,
    preintegration_parameters,
)
from incremental_mapper.graph.factors import (
    FactorKind,
    between_factor,
    gnss_factor,
    imu_factor,
    pose_sigmas,
)
from incremental_mapper.graph.frontier import Frontier
from incremental_mapper.map.store import MemoryStore
from incremental_mapper.mapping.fit_watch import FitWatch
from incremental_mapper.mapping.judgement import CLOUDS, judge_map, judged, residuals
from incremental_mapper.mapping.statistics import Totals
from incremental_mapper.smoothing.graph_state import (
    GraphState,
    PlacedCluster,
    PlacedFix,
    PlacedScan,
)
from incremental_mapper.variables import bias_key, pose_key, velocity_key

S = 1_000_000_000
STEP = 0.5
"""Metres between two poses, 0.1 s apart."""


def straight(count, turned=0.0, fixes_off=0.0, until=None, sigma=0.03):
    """A map of two LiDARs that drives forward.

    ``turned`` (degrees) is how wrong the yaw of the left one's extrinsics is; ``fixes_off`` metres
    are added to the fixes from half of the drive on.
    """
    state = GraphState(georeferenced=True, enu_offset=np.zeros(3))
    yaw = np.radians(turned)
    moves = {'left': gtsam.Point3(STEP * np.cos(yaw), STEP * np.sin(yaw), 0.0)}
    moves['right'] = gtsam.Point3(STEP, 0.0, 0.0)
    for index in range(count):
        stamp = index * S // 10
        core = [CoreMeasurement(stamp, name, CoreKind.LIDAR) for name in moves]
        state.clusters.append(PlacedCluster(index, index, Cluster(tuple(core))))
        place = np.array([index * STEP, 0.0, 0.0])
        state.values.insert(pose_key(index), gtsam.Pose3(gtsam.Rot3(), place))
        for name, move in moves.items() if index else ():
            state.factors.append(
                between_factor(
                    FactorKind.ODOMETRY,
                    (pose_key(index - 1), pose_key(index)),
                    gtsam.Pose3(gtsam.Rot3(), move),
                    np.diag(pose_sigmas(sigma, 0.003) ** 2),
                    name,
                    (stamp - S // 10, stamp),
                )
            )
        if index % 10 == 0:
            fix = place + [0.0, fixes_off * (index >= count // 2), 0.0]
            noise = 0.01 * np.eye(3)
            state.factors.append(
                gnss_factor(pose_key(index), fix, noise, np.zeros(3), 3.0, 'gnss', stamp)
            )
            factor = len(state.factors) - 1
            state.fixes.append(PlacedFix(index, stamp, fix, noise, np.zeros(3), factor))
    state.frontier = Frontier(newest=count - 1, newest_stamp=(count - 1) * S // 10)
    return state


def rules(state):
    return {item.rule: item for item in judge_map(state, state.values, Config())}


def test_a_sound_map_has_no_finding():
    assert rules(straight(120)) == {}
    assert rules(GraphState()) == {}


def with_spans(apart, unit):
    """Spans of an IMU whose poses lie ``apart`` metres too far from each other, and too near."""
    state, settings = straight(120), ImuSettings(accelerometer_noise=0.003)
    parameters = preintegration_parameters(settings, np.eye(4))
    none, still = gtsam.imuBias.ConstantBias(), np.zeros((10, 3))
    forces = np.tile([0.0, 0.0, settings.gravity * unit], (10, 1))
    for index in range(120):
        place = np.array([index * STEP, 0.0, apart * (index % 2)])
        state.values.update(pose_key(index), gtsam.Pose3(gtsam.Rot3(), place))
        state.values.insert(velocity_key(index), np.array([10.0 * STEP, 0.0, 0.0]))
        state.values.insert(bias_key(index), none)
    for index in range(1, 120):
        start, end = (index - 1) * S // 10, index * S // 10
        stamps = np.arange(start, end, S // 100) + S // 200
        samples = ImuSeries(stamps, still, forces)
        span = integrate(samples, start, end, parameters, none, constant_bias=True)
        factor = imu_factor(index - 1, index, span, 'imu', (start, end), stamps)
        state.factors.append(factor)
    return state


def test_estimates_that_were_told_one_after_the_other_are_millimetres_apart():
    assert rules(with_spans(0.0, 1.0)) == {}
    assert 'imu_misfit' not in rules(with_spans(0.006, 1.0))
    assert 'imu_misfit' in rules(with_spans(0.0, 1.1))
    assert 'imu_misfit' in rules(with_spans(0.3, 1.0))


def test_a_robust_loss_does_not_hide_what_fixes_say():
    state = straight(120, fixes_off=5.0)
    (fixes,) = [
        item for item in residuals(judged(state.factors), state.values) if item.kind == 'gnss'
    ]
    assert fixes.squared[-1] == pytest.approx(5.0**2 / 0.01 / 3)
    assert fixes.metres[-1] == pytest.approx(5.0)
    found = rules(state)['gnss_misfit']
    assert found.sensor == 'gnss' and '5.00 m' in found.text


@pytest.mark.parametrize(('distrusted', 'told'), [(6, True), (2, False)])
def test_fixes_without_weight_in_a_map_are_told_of(distrusted, told):
    state = straight(120)
    for fix in state.fixes[-distrusted:]:
        wide = fix.covariance + 1e8 * np.eye(3)
        key = state.factors[fix.factor].keys[0]
        state.factors[fix.factor] = gnss_factor(
            key, fix.enu, wide, np.zeros(3), 3.0, 'gnss', fix.stamp
        )
    found = rules(state)
    assert ('fixes_distrusted' in found) is told
    if told:
        assert '6 of 12 fixes' in found['fixes_distrusted'].text


@pytest.mark.parametrize(('off', 'severity'), [(5.0, Severity.ERROR), (0.3, Severity.WARNING)])
def test_a_map_that_most_fixes_contradict_is_an_error(off, severity):
    state = straight(120)
    for fix in state.fixes[3:]:
        wide = fix.covariance + 1e8 * np.eye(3)
        key = state.factors[fix.factor].keys[0]
        place = fix.enu + np.array([0.0, off, 0.0])
        state.factors[fix.factor] = gnss_factor(
            key, place, wide, np.zeros(3), 3.0, 'gnss', fix.stamp
        )
    found = rules(state)['fixes_distrusted']
    assert found.severity is severity
    assert f'{off:.1f} m' in found.text


def test_ranges_of_one_lidar_that_are_too_long_are_told_of():
    state = straight(120)
    for number, factor in enumerate(state.factors):
        if factor.kind is FactorKind.ODOMETRY and factor.sensor == 'left':
            state.factors[number] = between_factor(
                FactorKind.ODOMETRY,
                factor.keys,
                gtsam.Pose3(gtsam.Rot3(), gtsam.Point3(1.1 * STEP, 0.0, 0.0)),
                factor.factor.noiseModel().covariance(),
                'left',
                factor.stamps,
            )
    assert rules(state)['ways_differ'].sensor == 'left'


def test_of_lidars_that_drive_apart_only_the_cause_is_told():
    found = rules(straight(120, turned=90.0))
    assert set(found) == {'lidars_disagree'}
    assert found['lidars_disagree'].sensor == 'left'
    assert found['lidars_disagree'].severity is Severity.ERROR


def test_matches_that_the_scans_hold_weakly_tell_nothing_of_how_the_lidars_stand():
    assert set(rules(straight(120, turned=90.0, sigma=0.06))) == {'lidars_disagree'}
    assert 'lidars_disagree' not in rules(straight(120, turned=90.0, sigma=0.3))


def test_a_growing_map_is_judged_now_and_then():
    """As the node has it: the same state, seen again and again while it grows."""
    watch, whole = FitWatch(Config()), straight(200, turned=60.0)
    told = []
    for count in range(1, 200):
        state = GraphState(
            values=whole.values,
            clusters=whole.clusters[:count],
            factors=[f for f in whole.factors if f.stamps[-1] < count * S // 10],
            frontier=Frontier(newest=count - 1, newest_stamp=(count - 1) * S // 10),
        )
        watch.window(state)
        told.append(len(watch.found))
    assert told[40] == 0 and told[60] == 1
    assert [item.rule for item in watch.found] == ['lidars_disagree']


def test_clouds_do_not_pile_up_where_a_lidar_fell_silent():
    """Kept for a look at the ground, for which one of the LiDARs never has enough."""
    watch, whole, store = FitWatch(Config()), straight(700), MemoryStore()
    kept = []
    for count in range(10, 700, 50):
        names = ['left', 'right'] if count < 100 else ['left']
        points = np.full((100, 3), count, dtype=np.float32)
        kept.append(weakref.ref(points))
        recent = deque(
            (PlacedScan(0, 0, name, store.put(points), gtsam.Pose3()), points) for name in names
        )
        watch.window(
            GraphState(
                values=whole.values,
                clusters=whole.clusters[:count],
                recent=recent,
                frontier=Frontier(newest=count - 1, newest_stamp=(count - 1) * S // 10),
            )
        )
    del points, recent
    assert sum(item() is not None for item in kept) <= CLOUDS + 2


def test_outcome_counts_what_is_in_the_map():
    state, watch = straight(120), FitWatch(Config())
    for _ in range(2):  # nothing is counted twice
        notes = {'left: match rejected': 4, 'left: held weakly in some direction': 9}
        outcome = watch.outcome(state, Totals(bridges=3), notes, [])
    assert outcome.matched == {'left': 119, 'right': 119}
    assert outcome.reasons == {'left': '4 match rejected'}
    assert (outcome.clusters, outcome.bridges, outcome.fixes) == (120, 3, 12)
    assert outcome.farthest == pytest.approx(119 * STEP)


def test_wrong_extrinsics_end_with_status_1(map_light, light_drive):
    wrong = 'lidars:\n  names: [left, right]\n  left:\n    T_base_sensor: [0, 0, 0, 0, 0, 0, 1]\n'
    run = map_light(light_drive, config=wrong)
    assert run.status == 1
    assert run.stats['warnings'][0]['severity'] == 'error'
    rules = {item['rule'] for item in run.stats['warnings']}
    assert 'lidars_disagree' in rules
    last = [line for line in run.err.splitlines() if line.startswith(('error', 'warning'))][-1]
    assert last.startswith('error: ')


def test_a_check_that_fails_costs_no_map(caplog):
    state = straight(120)
    broken = gnss_factor(pose_key(0), np.zeros(3), np.eye(3), np.zeros(3), 3.0, 'gnss', 0)
    state.factors.append(replace(broken, describe=lambda _: {'covariance': np.zeros((3, 3))}))
    with caplog.at_level(logging.WARNING, logger='incremental_mapper'):
        assert judge_map(state, state.values, Config()) == []
    assert 'a check of the map failed' in caplog.text
