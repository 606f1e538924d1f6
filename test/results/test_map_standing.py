"""A drive of a vehicle that stands, from end to end."""

import numpy as np
import pytest
from drive_edits import cut_drive

from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.measurements import NANOSECONDS

SECONDS = 3.0


@pytest.fixture(scope='module')
def parked(tmp_path_factory):
    pytest.importorskip('embreex', reason='embreex is not installed (extra "sim")')
    folder = tmp_path_factory.mktemp('drives') / 'parked'
    simulate(folder, SimulationOptions(motion=MotionKind.ZERO, duration=SECONDS, seed=4))
    cut_drive(folder, SECONDS, every=2)
    return folder


def test_what_is_measured_at_rest_adds_hardly_a_variable_and_nothing_is_lost(map_light, parked):
    run = map_light(parked, strategy='mom')
    assert run.status == 0
    stats = run.stats
    assert stats['standing_windows'] > 15, 'of 30'
    assert stats['vertices'] < 0.35 * stats['base_vertices'], 'half a second is not believed yet'
    assert stats['components'] == 1 and stats['dropped'] == {}
    for sensor in ('left', 'right', 'gnss'):
        assert len(run.used(sensor)) == stats['received'][sensor]
    assert len(run.factors('gnss')) == stats['received']['gnss']
    assert not [item for item in stats['warnings'] if item['rule'].startswith('sensor_')]
    stamps = run.trajectory.stamps
    assert (np.diff(stamps) > 0).all() and np.diff(stamps).max() < 0.3 * NANOSECONDS
    assert len(stamps) == stats['clusters'] + stats['standing_windows']
    assert stats['ate_rmse_m'] < 0.03


def test_the_conventional_graph_has_a_pose_for_everything(map_light, parked):
    run = map_light(parked, strategy='base')
    assert run.stats['standing_windows'] == 0
    assert run.stats['vertices'] == run.stats['base_vertices']


def test_without_the_rule_every_measurement_has_a_cluster_of_its_window(map_light, parked):
    run = map_light(parked, config='selection:\n  join_standing: false\n', strategy='fewest')
    assert run.stats['standing_windows'] == run.stats['joined_measurements'] == 0
    assert all('joined' not in item for item in run.graph['clusters'])
    assert len(run.trajectory) == run.stats['clusters']
