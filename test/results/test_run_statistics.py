"""``stats.json`` as one record: which keys it has, in which order, and what they are made of."""

import json
from collections import Counter
from dataclasses import fields, replace

import gtsam
import numpy as np
import pytest

from incremental_mapper.candidates.model import Cluster, CoreKind, CoreMeasurement
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.mapping.statistics import MapStatistics
from incremental_mapper.results.run_statistics import InputFacts, RunStatistics, sensor_uses
from incremental_mapper.results.trajectory_errors import TrajectoryErrors
from incremental_mapper.smoothing.graph_state import PlacedCluster
from incremental_mapper.trajectory import Trajectory

FACTS = InputFacts('drive', 'KAIST folder', {'left': 3}, ('a note',))
ERRORS = TrajectoryErrors(0.1, 0.2, None, None, 0.3, 4, 0)
ADDED = ['wall_s', 'real_time_factor', 'peak_rss_mb']
ENDING = ['versions', 'interrupted', 'map_points']


@pytest.fixture
def result():
    """Twenty windows of 1 to 20 ms and one without a core measurement."""
    nothing = {item.name: 0 for item in fields(MapStatistics)}
    counted = {'dropped': {'left': {'late': 1}}, 'drive_s': 6.0, 'verification': None}
    rows = [{'core': 2, 'window_s': 1e-3 * number} for number in range(1, 21)]
    return MapResult(
        clusters=(),
        factors=(),
        values=gtsam.Values(),
        trajectory=Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4))),
        scans=(),
        fixes=np.zeros((0, 3)),
        rows=(*rows, {'core': 0, 'window_s': 9.0}),
        statistics=MapStatistics(**{**nothing, **counted}),
    )


def test_keys_stand_in_their_order(result):
    windows = ['median', 'p99', 'first_tenth', 'last_tenth']
    tree = RunStatistics.of_run(result, Counter(), 2.0, 7, FACTS, ERRORS).to_tree()
    assert list(tree) == [
        'warnings',
        *result.statistics.to_tree(),
        *ADDED,
        *(f'window_{name}_s' for name in windows),
        *ENDING,
        'rpe_translation_rmse_m',
        'rpe_rotation_rmse_deg',
        'rpe_per_second_translation_rmse_m',
        'rpe_per_second_rotation_rmse_deg',
        'ate_rmse_m',
        'pairs',
        'poses_without_truth',
        'input',
    ]
    assert json.loads(json.dumps(tree)) == tree


def test_without_truth_and_windows_their_keys_are_missing(result):
    tree = RunStatistics.of_run(replace(result, rows=()), Counter(), 2.0, 7, FACTS).to_tree()
    assert list(tree) == ['warnings', *result.statistics.to_tree(), *ADDED, *ENDING, 'input']


def test_numbers_of_a_run(result):
    made = RunStatistics.of_run(result, Counter(), 2.0, 7, FACTS, interrupted=True)
    tree = made.to_tree()
    assert tree['real_time_factor'] == 3.0 and tree['map_points'] == 7
    assert tree['interrupted'] is True
    assert tree['input'] == {
        'path': 'drive',
        'kind': 'KAIST folder',
        'counts': {'left': 3},
        'notes': ['a note'],
    }
    assert tree['window_median_s'] == pytest.approx(10.5e-3)
    assert tree['window_p99_s'] == pytest.approx(19.81e-3)
    assert tree['window_first_tenth_s'] == pytest.approx(1.5e-3)
    assert tree['window_last_tenth_s'] == pytest.approx(19.5e-3)


def test_what_was_lost_before_the_mapper_is_counted_too(result):
    before = Counter({('left', 'late'): 2, ('left', 'empty'): 3, ('gnss', 'no_fix'): 4})
    tree = RunStatistics.of_run(result, before, 2.0, 7, FACTS).to_tree()
    assert tree['dropped'] == {'left': {'late': 3, 'empty': 3}, 'gnss': {'no_fix': 4}}
    assert result.statistics.dropped == {'left': {'late': 1}}


def test_scans_of_a_vehicle_that_stands_are_used(result):
    """They add no points, and 'most of the scans are not in the map' would be a false alarm."""
    core = tuple(CoreMeasurement(stamp, 'left', CoreKind.LIDAR) for stamp in range(90))
    fix = CoreMeasurement(95, 'gnss', CoreKind.GNSS)
    placed = PlacedCluster(0, 0, Cluster(core[:1]), joined=(*core[1:], fix))
    counted = replace(result.statistics, received={'left': 100}, settings={})
    stood = replace(result, clusters=(placed,), statistics=counted)
    uses = sensor_uses(stood, {}, Counter())
    assert [(item.name, item.offered, item.used) for item in uses if item.kind == 'lidar'] == [
        ('left', 100, 89)
    ]


def test_all_that_was_lost_before_the_mapper_was_offered(result):
    """Whatever the reasons: 'lost 5 of 3' is nonsense."""
    named = {'lidars': {'names': ['left']}}
    counted = replace(result.statistics, received={'left': 100}, settings=named)
    before = Counter({('left', 'late'): 2, ('left', 'undecodable'): 3})
    uses = sensor_uses(replace(result, statistics=counted), {}, before)
    assert next(item.offered for item in uses if item.name == 'left') == 105
