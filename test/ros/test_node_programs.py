"""Starting and ending the node and the player as programs of their own."""

import signal
import socket
import subprocess
import sys

import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.ros import programs
from incremental_mapper.ros.programs import DOMAINS, free_domain, local_environment, running

SLEEPER = 'import time; print("ready", flush=True); time.sleep(60)'
STUBBORN = f'import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {SLEEPER}'


def started(code):
    command = [sys.executable, '-c', code]
    return running(command, local_environment(1), stdout=subprocess.PIPE)


@pytest.mark.parametrize(
    ('code', 'ended_by'), [(SLEEPER, signal.SIGTERM), (STUBBORN, signal.SIGKILL)]
)
def test_program_ends_with_the_block_whatever_happens_in_it(monkeypatch, code, ended_by):
    monkeypatch.setattr(programs, '_PATIENCE', 0.3)
    with pytest.raises(KeyboardInterrupt), started(code) as process:
        assert process.stdout.readline() == 'ready\n'
        raise KeyboardInterrupt
    assert process.returncode == -ended_by


def test_program_that_has_ended_is_left_alone():
    with started('print("done")') as process:
        assert process.communicate() == ('done\n', None)
    assert process.returncode == 0


def test_free_domain_is_one_that_nobody_uses():
    wanted = free_domain()
    others = set(DOMAINS) - {wanted}
    assert free_domain(others) == wanted
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first_participant:
        first_participant.bind(('', 7410 + 250 * wanted))
        with pytest.raises(InputError, match='every ROS domain is in use'):
            free_domain(others)


def test_a_domain_that_another_process_was_given_is_not_free_before_it_is_used():
    wanted = free_domain()
    others = set(DOMAINS) - {wanted}
    code = (
        'import sys; from incremental_mapper.ros.programs import free_domain; '
        'from incremental_mapper.errors import InputError\n'
        f'try: print(free_domain({others}))\nexcept InputError: print("none")'
    )
    asked = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert asked.stdout.strip() == 'none'


def test_environment_keeps_ros_on_this_machine():
    environment = local_environment(42)
    assert environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert environment['ROS_DOMAIN_ID'] == '42' and environment['PATH']
