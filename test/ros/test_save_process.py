"""Saves in processes of their own: in turn, told of once, and not ended by what ends the node."""

import os
import signal
import time
from pathlib import Path

from incremental_mapper.errors import OutputError
from incremental_mapper.ros.save_process import Job, SaveProcesses
from incremental_mapper.ros.saving import Saved


class Told:
    """Processes, and what they told."""

    def __init__(self):
        self.remarks = []
        self.outcomes = []
        self.processes = SaveProcesses(self.remarks.append)

    def start(self, save, **more):
        self.processes.start(Job(save, pictures=False, **more), self.outcomes.append)

    def finish(self):
        self.processes.wait()
        assert self.processes.wait_for_pictures(300.0)


def test_saves_go_on_beside_and_one_after_the_other(tmp_path):
    told, log, go = Told(), tmp_path / 'log', tmp_path / 'go'

    def job(name):
        def save():
            with log.open('a') as file:
                file.write(f'{name}[')
                file.flush()
                while not go.exists():
                    time.sleep(0.01)
                file.write(']')
            return Saved(tmp_path / name)

        return save

    told.start(job('a'))
    told.start(job('b'))
    assert told.processes.saving == 2 and told.outcomes == [], 'starting waits for nobody'
    go.touch()
    told.finish()
    assert log.read_text() in ('a[]b[]', 'b[]a[]')
    assert {outcome.saved.folder.name for outcome in told.outcomes} == {'a', 'b'}
    assert told.processes.saving == 0


def test_a_save_holds_the_state_as_it_was(tmp_path):
    told, state, go = Told(), ['then'], tmp_path / 'go'

    def save():
        while not go.exists():
            time.sleep(0.01)
        return Saved(Path(state[0]))

    told.start(save)
    state[0] = 'now'
    go.touch()
    told.finish()
    assert told.outcomes[0].saved.folder == Path('then')


def test_signals_that_end_the_node_do_not_end_it(tmp_path):
    told, pid = Told(), tmp_path / 'pid'

    def save():
        pid.write_text(str(os.getpid()))
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), number)
        return Saved(tmp_path / str(os.getsid(0) == os.getpid()))

    told.start(save)
    told.finish()
    assert told.outcomes[0].saved.folder.name == 'True', 'a session of its own'
    assert int(pid.read_text()) != os.getpid()


def test_failures_are_told_once_each(tmp_path):
    told = Told()

    def refused():
        raise OutputError('no room')

    for save in (refused, lambda: 1 / 0, lambda: os.kill(os.getpid(), signal.SIGKILL)):
        told.start(save)
        told.finish()
    no_room, fault, died = told.outcomes
    assert no_room.reason == 'no room' and not no_room.fault
    assert 'ZeroDivisionError' in fault.fault and not fault.died
    assert died.died and died.saved is None
    assert told.remarks == []


def test_what_cannot_follow_is_a_remark(tmp_path):
    told = Told()
    told.start(lambda: Saved(tmp_path), more=lambda folder: f'no picture in {folder.name}')
    told.finish()
    assert told.outcomes[0].saved.folder == tmp_path
    assert told.remarks == [f'no picture in {tmp_path.name}']


def test_pictures_of_a_folder_that_is_no_map_are_a_remark(tmp_path):
    told = Told()
    told.processes.start(Job(lambda: Saved(tmp_path)), told.outcomes.append)
    told.finish()
    assert told.outcomes[0].saved is not None
    (remark,) = told.remarks
    assert remark.startswith('no pictures: ') and 'is no output' in remark
