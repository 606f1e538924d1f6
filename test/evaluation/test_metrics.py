"""Numbers of the pieces of a drive: every cluster, factor, window and pair of poses in its own."""

import csv
import json

import numpy as np
import pytest

from incremental_mapper.evaluation.metrics import motion_metrics
from incremental_mapper.evaluation.segments import Motion, Segment
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory, write_tum

START = 1_544_590_798_000_000_000
STEP = NANOSECONDS // 2
ZERO, ACCEL = Motion.ZERO, Motion.ACCELERATION


def at(seconds):
    return START + round(seconds * NANOSECONDS)


SEGMENTS = (
    Segment(ZERO, at(0), at(2)),
    Segment(ACCEL, at(2), at(4)),
    Segment(ZERO, at(4), at(6)),
)


def straight(count):
    """A pose every half second, a metre further each time."""
    positions = np.c_[np.arange(float(count)), np.zeros((count, 2))]
    quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    return Trajectory(START + STEP * np.arange(count), positions, quaternions)


def write_run(folder, trajectory, inertial, windows):
    """The files of a run with a pose a stamp; clusters in ``inertial`` have a velocity too."""
    folder.mkdir()
    stamps = trajectory.stamps.tolist()
    variables = [{'key': f'x{i}', 'stamp_ns': stamp} for i, stamp in enumerate(stamps)]
    variables += [{'key': f'v{i}', 'stamp_ns': stamps[i]} for i in inertial]
    factors = [{'variables': ['x0']}]
    factors += [{'variables': [f'x{i}', f'x{i - 1}']} for i in range(1, len(stamps))]
    clusters = [{'stamp_ns': stamp} for stamp in stamps]
    graph = {'variables': variables, 'clusters': clusters, 'factors': factors}
    (folder / 'graph.json').write_text(json.dumps(graph))
    (folder / 'stats.json').write_text(json.dumps({'strategy': 'mom'}))
    write_tum(folder / 'trajectory.tum', trajectory)
    with (folder / 'windows.csv').open('w', newline='') as file:
        names = ['start_ns', 'end_ns', 'core', 'time_shift_s', 'solver_error', 'window_s']
        csv.writer(file).writerows([names, *windows])
    return FinishedRun(folder)


@pytest.fixture
def run(tmp_path):
    """Poses at 0, 0.5, .. 5.5 s: four a segment; a window a second, one of them empty."""
    windows = [
        [at(second), at(second + 1), 0 if second == 1 else 2, 0.5**second, 10.0**second, 0.25]
        for second in range(6)
    ]
    return write_run(tmp_path / 'run', straight(12), [3, 4, 5], windows)


def test_counts_are_those_in_the_pieces_of_a_motion(run):
    found = motion_metrics(run, None, SEGMENTS, None)
    assert list(found) == [ZERO, ACCEL]
    assert (found[ZERO]['clusters'], found[ACCEL]['clusters']) == (8, 4)
    assert (found[ZERO]['vertices'], found[ACCEL]['vertices']) == (8 + 1, 4 + 2)
    # A factor counts where its newest variable is; the prior of the first pose counts too.
    assert (found[ZERO]['factors'], found[ACCEL]['factors']) == (8, 4)


def test_windows_count_where_their_middle_is(run):
    found = motion_metrics(run, None, SEGMENTS, None)
    assert (found[ZERO]['windows'], found[ACCEL]['windows']) == (4, 2)
    assert found[ACCEL]['total_time_shift_s'] == pytest.approx(0.5**2 + 0.5**3)
    assert found[ACCEL]['solver_error'] == pytest.approx(1100.0)
    assert found[ZERO]['solver_error'] == pytest.approx(110_011.0)
    # Four seconds in three windows that were worked on.
    assert found[ZERO]['real_time_factor'] == pytest.approx(4.0 / 0.75)
    assert found[ACCEL]['window_median_s'] == 0.25


def test_errors_are_of_pairs_that_lie_in_one_piece(run):
    truth = straight(12)
    moved = truth.positions.copy()
    moved[4:, 1] += 7.0  # a jump between the last pose of the first piece and its successor
    moved[6:, 2] += 0.5  # and one within the second piece
    found = motion_metrics(run, None, SEGMENTS, Trajectory(truth.stamps, moved, truth.quaternions))
    assert found[ZERO]['rpe_translation_rmse_m'] == pytest.approx(0.0, abs=1e-9)
    assert found[ACCEL]['rpe_translation_rmse_m'] == pytest.approx(np.sqrt(0.5**2 / 3))
    assert found[ZERO]['rpe_per_second_translation_rmse_m'] == pytest.approx(0.0, abs=1e-9)
    assert found[ACCEL]['rpe_per_second_translation_rmse_m'] == pytest.approx(0.5)
    assert found[ZERO]['rpe_rotation_rmse_deg'] == pytest.approx(0.0, abs=1e-6)
    assert found[ACCEL]['ate_rmse_m'] > 0.0


def test_compression_is_against_the_base_run_in_the_same_pieces(run, tmp_path):
    fine = straight(12)
    stamps = np.sort(np.r_[fine.stamps, fine.stamps[4:8] + STEP // 2])
    base = write_run(
        tmp_path / 'base',
        Trajectory(stamps, np.zeros((16, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (16, 1))),
        [3, 4, 5],
        [],
    )
    found = motion_metrics(run, base, SEGMENTS, None)
    assert found[ZERO]['compression_vertices_percent'] == pytest.approx(0.0)
    assert found[ACCEL]['compression_vertices_percent'] == pytest.approx(100 * (1 - 6 / 10))
    assert found[ACCEL]['compression_factors_percent'] == pytest.approx(100 * (1 - 4 / 8))


def test_what_is_not_known_is_none(run):
    found = motion_metrics(run, None, SEGMENTS, None)
    for name in (
        'compression_vertices_percent',
        'rpe_translation_rmse_m',
        'ate_rmse_m',
        'components',
        'map_distance_m',
        'plane_variance_m2',
    ):
        assert found[ZERO][name] is None, name
    assert motion_metrics(run, None, (), None) == {}


UNEVEN = (
    Segment(ZERO, at(0), at(1.2)),
    Segment(ACCEL, at(1.2), at(4.1)),
    Segment(ZERO, at(4.1), at(5.8)),
)


def test_pieces_of_any_length_have_what_is_newest_and_in_the_middle_of_them(tmp_path):
    # Windows that lie across the ends of pieces, and one factor from the first into the second.
    windows = [
        [at(0.5), at(1.7), 2, 1.0, 1.0, 0.1],  # middle 1.1
        [at(1.0), at(1.6), 2, 2.0, 10.0, 0.2],  # middle 1.3
        [at(3.5), at(5.0), 2, 4.0, 100.0, 0.4],  # middle 4.25
    ]
    run = write_run(tmp_path / 'run', straight(12), [2, 3, 9], windows)
    graph = run.folder / 'graph.json'
    tree = json.loads(graph.read_text())
    tree['factors'] += [{'variables': ['x5', 'x1']}, {'variables': ['x0', 'x10']}]
    graph.write_text(json.dumps(tree))
    found = motion_metrics(FinishedRun(run.folder), None, UNEVEN, None)
    # Poses at 0, 0.5, 1 s; 1.5 to 4 s; 4.5 to 5.5 s.
    assert (found[ZERO]['clusters'], found[ACCEL]['clusters']) == (6, 6)
    assert (found[ZERO]['vertices'], found[ACCEL]['vertices']) == (6 + 2, 6 + 1)
    # The prior and two links; three links and one across; six links and one across.
    assert (found[ZERO]['factors'], found[ACCEL]['factors']) == (3 + 3 + 1, 6 + 1)
    assert (found[ZERO]['windows'], found[ACCEL]['windows']) == (2, 1)
    assert found[ZERO]['solver_error'] == 101.0 and found[ACCEL]['solver_error'] == 10.0
    assert found[ZERO]['total_time_shift_s'] == 5.0
    assert found[ZERO]['drive_s'] == pytest.approx(1.2 + 1.5)
    assert found[ACCEL]['drive_s'] == pytest.approx(0.6)
    assert found[ZERO]['wall_s'] == pytest.approx(0.5)
    assert found[ACCEL]['real_time_factor'] == pytest.approx(3.0)
    assert found[ZERO]['window_median_s'] == pytest.approx(0.25)


def test_jump_of_the_truth_between_two_pieces_is_neithers_error(tmp_path):
    run = write_run(tmp_path / 'run', straight(12), [], [])
    truth = straight(12)
    moved = truth.positions.copy()
    moved[3:, 1] += 5.0  # between the first and the second piece, at 1.2 s
    moved[11:, 2] += 0.7  # within the last one
    found = motion_metrics(run, None, UNEVEN, Trajectory(truth.stamps, moved, truth.quaternions))
    assert found[ACCEL]['rpe_translation_rmse_m'] == pytest.approx(0.0, abs=1e-9)
    # Two steps in the first piece and two in the last, one of which is wrong.
    assert found[ZERO]['rpe_translation_rmse_m'] == pytest.approx(np.sqrt(0.7**2 / 4))
    # The pose before the last has a partner half a second on, which is near enough to a second.
    per_second = found[ZERO]['rpe_per_second_translation_rmse_m']
    assert per_second == pytest.approx(np.sqrt(2 * 0.7**2 / 3))
