"""The parts of ``evaluate``: names of sequences, what the cache sees, and who does the work."""

import os
import time
from pathlib import Path

import pytest

from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.jobs import plan_jobs, sequence_names
from incremental_mapper.evaluation.workers import LocalWorkers, stop_of_this_process


def square_or_die(number):
    """Run in a worker: dies as a process that ran out of memory does."""
    if number == 3:
        os._exit(9)
    if number == 4:
        raise ValueError('four')
    time.sleep(0.2)
    return number * number


def run_until_stopped(path):
    """Run in a worker: tells that it runs, and then whether it was told to stop."""
    path.with_suffix('.begun').touch()
    limit = time.monotonic() + 30
    while not stop_of_this_process().wanted and time.monotonic() < limit:
        time.sleep(0.01)
    path.write_text('stopped' if stop_of_this_process().wanted else 'not stopped')


@pytest.mark.parametrize(
    ('paths', 'names'),
    [
        (['/data/urban26', '/data/urban33'], ['urban26', 'urban33']),
        (['/a/drive', '/b/drive', '/b/other'], ['a_drive', 'b_drive', 'other']),
        (['/x/a/drive', '/y/a/drive'], ['x_a_drive', 'y_a_drive']),
        (['/a_b/c', '/a/b_c', '/c'], None),
        (['/a/c', '/a_c', '/c'], None),
        (['/'], ['input']),
    ],
)
def test_sequences_have_names_of_their_own(paths, names):
    found = sequence_names([Path(path) for path in paths])
    assert len(set(found)) == len(paths)
    assert all(name and '/' not in name for name in found)
    assert names is None or found == names


def test_file_and_folder_of_one_name_are_told_apart(tmp_path):
    (tmp_path / 'drive').mkdir()
    (tmp_path / 'drive.mcap').touch()
    (tmp_path / 'drive.bag').touch()
    names = sequence_names([tmp_path / 'drive', tmp_path / 'drive.mcap', tmp_path / 'drive.bag'])
    assert len(set(names)) == 3
    assert sequence_names([tmp_path / 'drive.mcap']) == ['drive']


def test_input_given_twice_is_one_sequence(tmp_path):
    drive = tmp_path / 'drive'
    drive.mkdir()
    twice = [drive, tmp_path / '.' / 'drive' / '..' / 'drive']
    jobs = plan_jobs(twice, tmp_path / 'out', ['base', 'mom'], {}, 'settings')
    assert [(job.sequence, job.strategy) for job in jobs] == [('drive', 'base'), ('drive', 'mom')]
    assert all(job.folder.is_absolute() for job in jobs)


@pytest.fixture
def drive(tmp_path):
    folder = tmp_path / 'drive'
    (folder / 'sensor_data').mkdir(parents=True)
    (folder / 'sensor_data' / 'scan.bin').write_bytes(b'1234')
    return folder


def keys(drive, tree=None, truth=None):
    out = drive.parent / 'out'
    return {job.key for job in plan_jobs([drive], out, ['base', 'mom'], tree or {}, 'x', truth)}


def test_keys_depend_on_input_settings_strategy_and_truth(drive, tmp_path):
    first = keys(drive)
    assert len(first) == 2
    assert keys(drive) == first
    assert not keys(drive, {'mom': {'radius': 1.0}}) & first
    (tmp_path / 'truth.tum').write_text('0.0 0 0 0 0 0 0 1\n')
    with_truth = keys(drive, truth=tmp_path / 'truth.tum')
    assert not with_truth & first
    (tmp_path / 'truth.tum').write_text('0.5 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n')
    assert not keys(drive, truth=tmp_path / 'truth.tum') & with_truth


def _grow(drive):
    (drive / 'sensor_data' / 'scan.bin').write_bytes(b'12345')


def _touch(drive):
    os.utime(drive / 'sensor_data' / 'scan.bin', ns=(1, 1))


def _add(drive):
    (drive / 'sensor_data' / 'more.bin').touch()


def _rename(drive):
    (drive / 'sensor_data' / 'scan.bin').rename(drive / 'sensor_data' / 'other.bin')


def _truth_beside(drive):
    (drive.parent / 'ground_truth.tum').write_text('0.0 0 0 0 0 0 0 1\n')


@pytest.mark.parametrize('change', [_grow, _touch, _add, _rename, _truth_beside])
def test_every_change_of_the_input_is_seen(drive, change):
    before = keys(drive)
    change(drive)
    assert not keys(drive) & before


def test_program_counts_its_own_code(monkeypatch, tmp_path):
    import incremental_mapper

    before = cache.program()
    assert before['incremental_mapper'] == incremental_mapper.__version__
    (tmp_path / 'mapper').mkdir()
    (tmp_path / 'cli').mkdir()
    (tmp_path / 'mapper' / 'mapper.py').write_text('x = 1\n')
    found = []
    monkeypatch.setattr(incremental_mapper, '__file__', str(tmp_path / '__init__.py'))
    for name, text in (('mapper', 'x = 1\n'), ('cli', 'y = 1\n'), ('mapper', 'x = 2\n')):
        (tmp_path / name / f'{name}.py').write_text(text)
        cache.program.cache_clear()
        found.append(cache.program()['code'])
    cache.program.cache_clear()
    assert found[0] == found[1] != found[2]


def test_dead_process_takes_only_its_own_item_with_it():
    with LocalWorkers(2) as workers:
        found = dict(workers.run(square_or_die, [1, 2, 3, 4, 5, 6]))
    values = {item: future.result() for item, future in found.items() if not future.exception()}
    assert values == {1: 1, 2: 4, 5: 25, 6: 36}
    assert 'four' in str(found[4].exception())
    assert 'terminated abruptly' in str(found[3].exception())


def test_workers_are_told_to_stop(tmp_path):
    paths = [tmp_path / 'first', tmp_path / 'second', tmp_path / 'third']
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt), LocalWorkers(1) as workers:
        completed = workers.run(run_until_stopped, paths)
        _interrupt_once_begun(workers, paths[0], completed)
    assert time.monotonic() - started < 25
    assert paths[0].read_text() == 'stopped'
    assert not paths[1].exists() and not paths[2].exists()


def _interrupt_once_begun(workers, path, completed):
    """Wait for the first item in another thread's stead: Ctrl-C while the results are awaited."""
    import signal
    import threading

    def press():
        while not path.with_suffix('.begun').exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    try:
        list(completed)
    finally:
        thread.join()
