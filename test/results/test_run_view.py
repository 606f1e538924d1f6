"""Runs in Rerun: while they are mapped and from their folders, every window and fix is there."""

from functools import partial

import numpy as np
import pytest
from scipy.spatial import KDTree

from incremental_mapper.cli.main import main
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.offline_run import map_into
from incremental_mapper.results.opened_drive import open_drive
from incremental_mapper.results.run_view import run_view

chunk = pytest.importorskip('rerun.chunk', reason='rerun-sdk is not installed (extra "view")')


@pytest.fixture(scope='module')
def run(light_drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp('run')
    drive = open_drive(light_drive, {'mom': {'max_points': 100}}, 'test')
    map_into(folder, drive, watch=[partial(run_view, folder / 'live.rrd')])
    return folder


@pytest.fixture(scope='module', params=['live', 'finished'])
def recording(run, request):
    """Chunks of what was logged, by their place."""
    path = run / f'{request.param}.rrd'
    if request.param == 'finished':
        assert main(['view', str(run), '--save', str(path)]) == 0
    found = {}
    for one in chunk.RrdReader(str(path)).stream():
        found.setdefault(str(one.entity_path), []).append(one.to_record_batch())
    return found


def column(recording, place, name):
    return [
        row
        for batch in recording[place]
        for label in batch.schema.names
        if label.endswith(name)
        for row in batch.column(label).to_pylist()
        if row is not None
    ]


def test_numbers_of_every_window_are_those_of_the_table(run, recording):
    shown = sorted(row[0] for row in column(recording, '/numbers/solver_error', ':scalars'))
    rows = FinishedRun(run).windows
    assert np.allclose(shown, sorted(float(row['solver_error']) for row in rows), rtol=1e-12)


def test_every_fix_is_shown_once_with_its_ellipsoid(run, recording):
    shown = np.concatenate(column(recording, '/map/fixes', ':centers'))
    fixes = FinishedRun(run).fixes
    order = np.lexsort(fixes.T), np.lexsort(shown.T)
    assert np.abs(fixes[order[0]] - shown[order[1]]).max() < 1e-5
    assert np.min(column(recording, '/map/fixes', ':half_sizes')[0]) > 0.0


def test_spans_are_shown_wherever_their_bias_is(run, recording):
    (place,) = (name for name in recording if name.endswith('/imu'))
    strips = [len(row) for row in column(recording, place, ':strips')]
    known = [one for one in FinishedRun(run).graph['factors'] if one['kind'] == 'imu']
    assert known and max(strips) <= len(known) <= sum(strips)


def test_way_ends_where_the_trajectory_does(run, recording):
    way = column(recording, '/map/path', ':strips')[-1][0]
    assert np.abs(np.array(way[-1]) - FinishedRun(run).trajectory.positions[-1]).max() < 1e-3


def test_scores_begin_with_that_of_the_winner(run, recording):
    shown = column(recording, '/numbers/score', ':scalars')
    known = [float(row['score']) for row in FinishedRun(run).windows if row['score']]
    winners = [row[0] for row in shown if np.isfinite(row[0])]
    assert np.allclose(sorted(winners), sorted(known), rtol=1e-12)
    assert all(row[1] <= row[2] for row in shown)


def test_points_lie_in_the_map(run, recording):
    saved = KDTree(FinishedRun(run).points)

    def away(points):
        return np.median(saved.query(points)[0])

    for place in recording:
        if place.startswith('/map/points'):
            points = np.concatenate(column(recording, place, ':positions'))
            shifts, turns = (column(recording, place, name) for name in (':translation', ':mat3x3'))
            if shifts:  # the map became east, north, up
                turn = np.array(turns[-1][0]).reshape(3, 3).T  # by columns
                before, points = points, points @ turn.T + np.array(shifts[-1][0])
                assert away(before) > 2.0 * away(points)
            assert len(points) > 500 and away(points) < 0.2
