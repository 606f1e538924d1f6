"""Processes beside the windows are less urgent, in sessions of their own too."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from incremental_mapper.ros.urgency import LEAST, make_way

GROUP = Path('/proc/self/autogroup')


def told(nice, *before):
    """What a process of a session of its own says of itself afterwards."""
    code = (
        'import os\nfrom incremental_mapper.ros.urgency import make_way\n'
        f'for nice in {(*before, nice)}: make_way(nice)\n'
        'print(os.getpriority(os.PRIO_PROCESS, 0))\n'
        f'print(open("{GROUP}").read().strip() if os.path.exists("{GROUP}") else "")\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], check=True, capture_output=True, text=True,
        start_new_session=True,
    )  # fmt: skip
    return done.stdout.splitlines()


def test_a_process_and_its_session_make_way():
    own = os.getpriority(os.PRIO_PROCESS, 0)
    nice, group = told(7)[:2]
    assert int(nice) == min(own + 7, LEAST)
    if not group:
        pytest.skip('this kernel does not group processes by sessions')
    assert group.endswith(f' nice {nice}')


def test_nothing_is_less_urgent_than_the_least():
    assert told(LEAST, 5)[0] == str(LEAST)


def test_another_process_that_is_gone_is_no_trouble():
    process = subprocess.Popen([sys.executable, '-c', ''], start_new_session=True)
    process.wait()
    make_way(5, process.pid)


@pytest.mark.skipif(not hasattr(os, 'SCHED_IDLE'), reason='the system has no such policy')
def test_who_gives_way_goes_on_when_nobody_else_does():
    code = (
        'import os\nfrom incremental_mapper.ros.urgency import give_way\ngive_way()\n'
        'print(os.sched_getscheduler(0) == os.SCHED_IDLE)'
    )
    done = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True, text=True)
    assert done.stdout == 'True\n'
