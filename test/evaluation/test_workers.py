"""Who does the work: processes that die or are stopped."""

import os
import signal
import threading
import time

import pytest

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
