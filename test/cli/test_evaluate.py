"""``evaluate``: every strategy on every input, once, side by side, and what it writes of them."""

import csv
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from distributed import LocalCluster
from drive_edits import cut_drive
from evo.core import metrics, sync
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

from incremental_mapper.cli import evaluate
from incremental_mapper.cli.main import main
from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.trajectory_errors import trajectory_errors
from incremental_mapper.trajectory import match_truth, read_tum

STRATEGIES = ('base', 'min_solver_error')
SECONDS = 1.4
SETTINGS = 'mom:\n  max_points: 100\n'
OF_TIME = {'window_median_s', 'real_time_factor', 'wall_s'}


@dataclass(frozen=True)
class Call:
    """What one ``evaluate`` command did."""

    status: int
    out: str
    err: str
    folder: Path

    @property
    def record(self):
        return json.loads((self.folder / 'evaluation.json').read_text())

    @property
    def jobs(self):
        return {(job['sequence'], job['strategy']): job for job in self.record['jobs']}

    def text(self, name):
        return (self.folder / name).read_text(encoding='utf-8')

    def rerun(self):
        """Sequences and strategies that were run and not taken from an earlier call."""
        return {key for key, job in self.jobs.items() if not job['reused']}


def call(capsys, inputs, out, *options, strategies=STRATEGIES):
    """Run the command in this process; the page has tests of its own and is left out."""
    capsys.readouterr()
    words = [*inputs, '--out', out, '--strategies', ','.join(strategies), *options]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, '_write_report', lambda out_dir: None)
        status = main(['evaluate', *map(str, words)])
    printed = capsys.readouterr()
    assert 'Traceback' not in printed.err
    return Call(status, printed.out, printed.err, out)


def numbers(done):
    """All that does not depend on how long it took."""
    return {
        key: {name: value for name, value in job['metrics'].items() if name not in OF_TIME}
        for key, job in done.jobs.items()
    }


def assert_same_runs(one, sequence, other, other_sequence):
    """The runs of a sequence do not differ in a byte, whoever made them."""
    for strategy in STRATEGIES:
        for name in ('trajectory.tum', 'map.ply', 'graph.json'):
            ours = (one.folder / sequence / strategy / name).read_bytes()
            theirs = (other.folder / other_sequence / strategy / name).read_bytes()
            assert ours == theirs, (strategy, name)
        assert numbers(one)[sequence, strategy] == numbers(other)[other_sequence, strategy]


def ends_within(group, seconds):
    """Whether no process of the group is left; multiprocessing's tracker ends after its parent."""
    limit = time.monotonic() + seconds
    while time.monotonic() < limit:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


@pytest.fixture(scope='module')
def inputs(light_drive, tmp_path_factory):
    """Two drives of the same name; the second one has no truth."""
    root = tmp_path_factory.mktemp('inputs')
    for day in ('monday', 'tuesday'):
        shutil.copytree(light_drive, root / day / 'drive')
        cut_drive(root / day / 'drive', SECONDS)
    (root / 'tuesday' / 'drive' / 'global_pose.csv').unlink()
    return [root / day / 'drive' for day in ('monday', 'tuesday')]


@pytest.fixture(scope='module')
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp('settings') / 'settings.yaml'
    path.write_text(SETTINGS)
    return path


@pytest.fixture(scope='module')
def kept():
    return {}


@pytest.fixture
def done(kept, inputs, config, tmp_path_factory, capsys):
    """Both inputs evaluated, once; not to be written to."""
    if 'done' not in kept:
        out = tmp_path_factory.mktemp('evaluated') / 'out'
        kept['done'] = call(capsys, inputs, out, '--config', config)
    return kept['done']


@pytest.fixture
def copy(done, tmp_path):
    """A copy of ``done`` to go on with."""
    return Path(shutil.copytree(done.folder, tmp_path / 'out'))


def test_every_strategy_maps_every_input_into_a_folder_of_its_own(done):
    assert done.status == 0
    assert set(done.jobs) == {
        (sequence, strategy)
        for sequence in ('monday_drive', 'tuesday_drive')
        for strategy in STRATEGIES
    }
    assert done.record['status'] == 'finished'
    assert done.record['command'].startswith('incremental_mapper evaluate ')
    assert done.record['command'] in done.text('table.md')
    for (sequence, strategy), job in done.jobs.items():
        assert job['status'] == 'done' and job['error'] is None and not job['reused']
        folder = done.folder / sequence / strategy
        assert done.folder / job['folder'] == folder
        stats = json.loads((folder / 'stats.json').read_text())
        assert stats['strategy'] == strategy
        assert job['settings'] == stats['settings']
        assert job['settings']['mom']['max_points'] == 100
        for name, value in job['metrics'].items():
            if name in stats:
                assert value == stats[name], name
        for name in ('trajectory.tum', 'map.ply', 'graph.json', 'windows.csv'):
            assert (folder / name).is_file()


def test_table_says_what_the_runs_say(done):
    with (done.folder / 'table.csv').open(newline='') as file:
        lines = {(line['sequence'], line['strategy']): line for line in csv.DictReader(file)}
    for key, job in done.jobs.items():
        for row in done.record['rows']:
            value = job['metrics'][row['name']]
            shown = lines[key][row['name']]
            assert shown == '' if value is None else float(shown) == value
    base, other = (
        done.jobs['monday_drive', strategy]['metrics']['clusters'] for strategy in STRATEGIES
    )
    printed = next(line for line in done.out.splitlines() if line.startswith('Clusters'))
    assert [int(word.strip('*+')) for word in printed.split()[1:3]] == [base, other]
    markdown = next(line for line in done.text('table.md').splitlines() if 'Clusters' in line)
    assert [cell.strip(' *_') for cell in markdown.split('|')[2:4]] == [str(base), str(other)]


def test_base_is_compared_with_itself_at_no_distance(done):
    for sequence in ('monday_drive', 'tuesday_drive'):
        base = done.jobs[sequence, 'base']['metrics']
        other = done.jobs[sequence, 'min_solver_error']['metrics']
        assert base['map_distance_m'] == pytest.approx(0.0, abs=1e-9)
        assert base['compression_vertices_percent'] == 0.0
        assert 0.0 < other['map_distance_m'] < 0.5
        assert other['plane_variance_m2'] > 0.0


def test_input_without_truth_has_dashes_and_is_named(done):
    metrics = done.jobs['tuesday_drive', 'base']['metrics']
    assert metrics['rpe_translation_rmse_m'] is None and metrics['ate_rmse_m'] is None
    assert metrics['clusters'] > 0
    assert 'tuesday_drive: no truth' in done.out
    sequences = {item['name']: item for item in done.record['sequences']}
    assert sequences['tuesday_drive']['truth'] is None
    assert sequences['monday_drive']['truth'] == 'monday_drive/truth.tum'
    rpe = next(line for line in done.out.splitlines() if line.startswith('RPE, m'))
    assert '–' in rpe


def test_truth_is_copied_beside_the_runs(done, inputs):
    ours = read_tum(done.folder / 'monday_drive' / 'truth.tum')
    theirs = read_truth(inputs[0] / 'global_pose.csv')
    np.testing.assert_array_equal(ours.stamps, theirs.stamps)
    np.testing.assert_allclose(ours.positions, theirs.positions, atol=1e-9)


@pytest.mark.parametrize('strategy', STRATEGIES)
def test_errors_equal_those_of_evo_on_the_same_files(done, strategy):
    """evo pairs poses of equal stamps, so the truth is interpolated for it."""
    path = done.folder / 'monday_drive' / strategy / 'trajectory.tum'
    estimate = read_tum(path)
    truth = read_tum(done.folder / 'monday_drive' / 'truth.tum')
    ours = trajectory_errors(estimate, truth)
    _, at_stamps = match_truth(estimate, truth)
    reference = PoseTrajectory3D(
        positions_xyz=at_stamps.positions,
        orientations_quat_wxyz=np.roll(at_stamps.quaternions, 1, axis=1),
        timestamps=at_stamps.stamps / NANOSECONDS,
    )
    own = file_interface.read_tum_trajectory_file(path)
    reference, own = sync.associate_trajectories(reference, own, max_diff=1e-6)
    assert own.num_poses == len(estimate) - ours.poses_without_truth > 10

    def rmse(metric):
        metric.process_data((reference, own))
        return metric.get_statistic(metrics.StatisticsType.rmse)

    step = {'delta': 1, 'delta_unit': metrics.Unit.frames}
    translation = rmse(metrics.RPE(PoseRelation.translation_part, **step))
    rotation = rmse(metrics.RPE(PoseRelation.rotation_angle_deg, **step))
    own.align(reference)
    absolute = rmse(metrics.APE(PoseRelation.translation_part))
    assert ours.rpe_translation_rmse_m == pytest.approx(translation, abs=1e-9)
    assert ours.rpe_rotation_rmse_deg == pytest.approx(rotation, abs=1e-9)
    assert ours.ate_rmse_m == pytest.approx(absolute, abs=1e-9)
    # What the table shows was computed before the poses were rounded to nine decimals.
    shown = done.jobs['monday_drive', strategy]['metrics']
    assert shown['rpe_translation_rmse_m'] == pytest.approx(translation, abs=2e-9)
    assert shown['rpe_rotation_rmse_deg'] == pytest.approx(rotation, abs=1e-6)
    assert shown['ate_rmse_m'] == pytest.approx(absolute, abs=2e-9)


def test_two_jobs_at_a_time_give_the_same_numbers(done, inputs, config, tmp_path, capsys):
    both = call(capsys, inputs[:1], tmp_path / 'out', '--config', config, '--jobs', 2)
    assert both.status == 0
    assert_same_runs(both, 'drive', done, 'monday_drive')


def test_workers_of_a_dask_cluster_give_the_same_numbers(done, inputs, config, tmp_path, capsys):
    out = tmp_path / 'out'
    with LocalCluster(
        n_workers=2, threads_per_worker=1, host='127.0.0.1', dashboard_address=None
    ) as cluster:
        options = ('--config', config, '--scheduler', cluster.scheduler_address)
        both = call(capsys, inputs[:1], out, *options)
        again = call(capsys, inputs[:1], out, *options)
    assert both.status == 0
    assert_same_runs(both, 'drive', done, 'monday_drive')
    assert again.rerun() == set()


def test_scheduler_without_its_extra_says_what_to_install(light_drive, tmp_path, capsys):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, 'distributed', None)
        done = call(capsys, [light_drive], tmp_path / 'out', '--scheduler', 'tcp://127.0.0.1:1')
    assert done.status == 1
    assert done.err.count('\n') == 1 and 'incremental_mapper[cluster]' in done.err


def test_second_call_runs_nothing(done, copy, inputs, config, capsys):
    marks = {path: path.stat().st_mtime_ns for path in copy.glob('*/*/*')}
    again = call(capsys, inputs, copy, '--config', config)
    assert again.status == 0
    assert again.rerun() == set()
    assert '4 of 4 jobs were already done' in again.err
    assert numbers(again) == numbers(done)
    assert {path: path.stat().st_mtime_ns for path in marks} == marks


def test_another_setting_runs_again(copy, inputs, tmp_path, capsys):
    changed = tmp_path / 'changed.yaml'
    changed.write_text(SETTINGS.replace('100', '90'))
    again = call(capsys, inputs, copy, '--config', changed, strategies=('base',))
    assert again.rerun() == {('monday_drive', 'base'), ('tuesday_drive', 'base')}
    assert all(job['settings']['mom']['max_points'] == 90 for job in again.jobs.values())


def test_changed_input_runs_again(copy, inputs, config, tmp_path, capsys):
    moved = tmp_path / 'monday' / 'drive'
    shutil.copytree(inputs[0], moved)  # with the times of the files
    with (moved / 'sensor_data' / 'vrs_gps.csv').open('a') as file:
        file.write('\n')
    given = [moved, inputs[1]]
    again = call(capsys, given, copy, '--config', config, strategies=('base',))
    assert again.rerun() == {('monday_drive', 'base')}


@pytest.mark.parametrize('name', ['finished.json', 'graph.json'])
def test_half_written_job_does_not_count(copy, inputs, config, capsys, name):
    (copy / 'monday_drive' / 'base' / name).unlink()
    again = call(capsys, inputs, copy, '--config', config)
    assert again.status == 0
    assert again.rerun() == {('monday_drive', 'base')}
    assert (copy / 'monday_drive' / 'base' / name).is_file()


def test_force_runs_everything_again(copy, inputs, config, capsys):
    again = call(capsys, inputs, copy, '--config', config, '--force', strategies=('base',))
    assert again.status == 0
    assert again.rerun() == {('monday_drive', 'base'), ('tuesday_drive', 'base')}


def test_findings_are_counted_and_an_error_flags_its_run(copy, inputs, config, capsys):
    wrong = {'severity': 'error', 'rule': 'lidars_disagree', 'sensor': 'left', 'text': 'turned'}
    doubtful = {'severity': 'warning', 'rule': 'sensor_silent', 'sensor': 'imu', 'text': 'silent'}
    mended = {'severity': 'mended', 'rule': 'imu_in_g', 'sensor': 'imu', 'text': 'in g'}
    path = copy / 'monday_drive' / 'base' / 'stats.json'
    stats = json.loads(path.read_text())
    stats['warnings'] = [wrong, doubtful, mended]
    path.write_text(json.dumps(stats))
    again = call(capsys, inputs, copy, '--config', config)
    assert again.status == 1 and again.rerun() == set()
    job = again.jobs['monday_drive', 'base']
    assert job['status'] == 'done' and job['metrics']['clusters'] > 0
    assert job['metrics']['findings'] == 2
    assert [item['rule'] for item in job['findings']] == [
        'lidars_disagree',
        'sensor_silent',
        'imu_in_g',
    ]
    told = [line for line in again.out.splitlines() if 'monday_drive, base: ' in line]
    assert told == [
        'warning: monday_drive, base: imu: silent (sensor_silent)',
        'error: monday_drive, base: left: turned (lidars_disagree)',
    ]
    assert re.search(r'^Warnings +2', again.out, flags=re.MULTILINE)


def test_broken_input_is_reported_and_the_others_finish(inputs, config, tmp_path, capsys):
    broken = tmp_path / 'broken'
    broken.mkdir()
    (broken / 'notes.txt').write_text('nothing here')
    missing = tmp_path / 'missing.mcap'
    given = [broken, inputs[0], missing]
    done = call(capsys, given, tmp_path / 'out', '--config', config)
    assert done.status == 1
    statuses = {key: job['status'] for key, job in done.jobs.items()}
    assert {statuses['drive', strategy] for strategy in STRATEGIES} == {'done'}
    for name in ('broken', 'missing.mcap'):
        assert {statuses[name, strategy] for strategy in STRATEGIES} == {'failed'}
    assert f'failed: broken, base: {broken}: holds notes.txt' in done.err
    assert 'does not exist' in done.jobs['missing.mcap', 'base']['error']
    for text in (done.out, done.text('table.tex')):
        assert f'failed: broken, {", ".join(STRATEGIES)}: {broken}' in text
    assert 'failed: broken' in done.text('table.md')

    again = call(capsys, given, tmp_path / 'out', '--config', config)
    assert again.status == 1
    assert '2 of 6 jobs were already done' in again.err


def test_drive_is_cut_by_its_estimate_where_there_is_no_truth(copy, inputs, config, capsys):
    cut = call(capsys, inputs, copy, '--config', config, '--by-motion')
    assert cut.status == 0 and cut.rerun() == set()
    sources = {item['name']: item['segments_from'] for item in cut.record['sequences']}
    assert sources == {'monday_drive': 'truth', 'tuesday_drive': 'base'}
    for (_, strategy), job in cut.jobs.items():
        motions, whole = job['by_motion'], job['metrics']
        assert set(motions) == {'constant_speed'}
        for name in ('clusters', 'vertices', 'factors', 'windows'):
            assert sum(piece[name] for piece in motions.values()) == whole[name], name
        for name in ('total_time_shift_s', 'solver_error'):
            total = sum(piece[name] for piece in motions.values())
            assert total == pytest.approx(whole[name], rel=1e-9), name
        if whole['rpe_translation_rmse_m'] is not None:
            # The pieces are taken from the files, whose poses have nine decimals.
            piece = motions['constant_speed']
            for name in ('rpe_translation_rmse_m', 'ate_rmse_m'):
                assert piece[name] == pytest.approx(whole[name], abs=2e-9)
            name = 'rpe_rotation_rmse_deg'
            assert piece[name] == pytest.approx(whole[name], abs=1e-6)
        assert strategy != 'base' or motions['constant_speed']['compression_vertices_percent'] == 0
    assert 'Constant speed' in cut.out
    assert 'tuesday_drive: cut by the base run into constant speed' in cut.out


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (('--strategies', 'base,best'), ("'best'", 'min_time_shift')),
        (('--jobs', '0'), ('--jobs is 0',)),
        (('--config', 'none.yaml'), ('none.yaml', 'cannot be read')),
        (('--reference', 'none.csv'), ('none.csv', 'cannot be read')),
        (('--truth', 'none.tum'), ('none.tum', 'is no file')),
        (('--scheduler', 'nowhere'), ('--scheduler nowhere', 'missing port', 'dask scheduler')),
        (('--scheduler', 'tcp://127.0.0.1:1'), ('tcp://127.0.0.1:1: no Dask', 'dask scheduler')),
    ],
)
def test_wrong_options_are_one_line(light_drive, tmp_path, capsys, monkeypatch, options, words):
    monkeypatch.setattr('incremental_mapper.evaluation.workers.CONNECT_SECONDS', 0.5)
    status = main(['evaluate', str(light_drive), '--out', str(tmp_path / 'out'), *options])
    printed = capsys.readouterr()
    assert status == 1
    assert printed.err.count('\n') == 1 and printed.err.startswith('incremental_mapper: ')
    assert all(word in printed.err for word in words)
    assert not (tmp_path / 'out').exists()


def test_foreign_folder_is_not_written_into(light_drive, tmp_path, capsys):
    (tmp_path / 'letter.txt').write_text('dear')
    status = main(['evaluate', str(light_drive), '--out', str(tmp_path)])
    assert status == 1
    assert 'holds no evaluation' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['letter.txt']


def test_output_inside_an_input_is_refused(light_copy, capsys):
    assert main(['evaluate', str(light_copy), '--out', str(light_copy / 'out')]) == 1
    assert 'lies in the input' in capsys.readouterr().err
    assert not (light_copy / 'out').exists()


def test_ctrl_c_stops_and_the_next_call_goes_on(inputs, config, tmp_path):
    out = tmp_path / 'out'
    command = [sys.executable, '-m', 'incremental_mapper.cli.main', 'evaluate', *map(str, inputs)]
    command += ['--out', str(out), '--strategies', ','.join(STRATEGIES), '--config', str(config)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    first = out / 'monday_drive' / 'base' / 'finished.json'
    limit = time.monotonic() + 60
    while not first.is_file() and time.monotonic() < limit:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: the workers get it too
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors.splitlines()[-1] == 'incremental_mapper: interrupted'
    assert 'Traceback' not in errors
    assert 'jobs are done; the same call goes on' in errors
    assert ends_within(process.pid, 10)
    assert json.loads((out / 'evaluation.json').read_text())['status'] == 'running'

    again = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert again.returncode == 0, again.stderr
    found = int(again.stderr.split(' of 4 jobs were already done')[0].split()[-1])
    assert 1 <= found < 4
