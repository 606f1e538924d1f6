"""The node and the player as programs of their own: how they are called, started and ended."""

import fcntl
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir
from typing import IO, TypeAlias

from incremental_mapper.errors import InputError

Output: TypeAlias = IO[str] | int | None
"""Where a program's text goes: an open file, one of the constants of subprocess, or ours."""

NODE_NAME = 'incremental_mapper'
"""Name of the node that maps."""
INSTALL = 'pip install "incremental_mapper[ros]", or source a ROS 2 installation'
DOMAINS = range(1, 101)
"""Above 101 the ports may be taken by outgoing connections."""
_FIRST_PORT, _PORTS_OF_A_DOMAIN = 7410, 250
_CLAIMS: dict[int, tuple[IO[bytes], float]] = {}
"""The domains that this process was given of late, the files that say so to others, and when."""
_CLAIMED_FOR = 60.0
"""Seconds in which a program takes the domain that it was given; from then on its port says so."""
_PATIENCE = 30.0
"""Seconds that a program has to end by itself: the node maps what waits and saves."""


def free_domain(taken: Collection[int] = ()) -> int:
    """Find a ROS domain that nobody on this machine uses, or was given by this function.

    The port alone does not tell: seconds pass until the node that is to use it has it.

    Args:
        taken: domains that are left out.

    Returns:
        One of DOMAINS, by chance.

    Raises:
        InputError: all are in use.
    """
    for domain in random.SystemRandom().sample(DOMAINS, len(DOMAINS)):
        if domain in taken:
            continue
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                # DDS gives this port to the first participant of the domain.
                probe.bind(('', _FIRST_PORT + _PORTS_OF_A_DOMAIN * domain))
            except OSError:
                continue
        if _claimed(domain):
            return domain
    raise InputError('every ROS domain is in use on this machine')


def _claimed(domain: int) -> bool:
    """Whether this process has a domain to itself among those that ask here."""
    for old, (file, since) in list(_CLAIMS.items()):
        if time.monotonic() - since > _CLAIMED_FOR:
            file.close()
            del _CLAIMS[old]
    if domain in _CLAIMS:
        return True
    path = Path(gettempdir()) / f'incremental_mapper_domain_{domain}'
    try:
        # Any user may: what is in the way of one file is no reason to have no domain.
        with suppress(OSError):
            path.touch()
            path.chmod(0o666)
        file = path.open('rb')
    except OSError:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return False
    _CLAIMS[domain] = file, time.monotonic()
    return True


def local_environment(domain: int) -> dict[str, str]:
    """This process's environment, with ROS kept to this machine and to one domain."""
    local = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_DOMAIN_ID': str(domain)}
    return {**os.environ, **local}


def node_command(
    files: Sequence[Path] = (), parameters: Mapping[str, object] | None = None
) -> list[str]:
    """Put together how the node is called.

    Args:
        files: parameter files; what a later one sets wins.
        parameters: single parameters by name, which win over the files.

    Returns:
        Program and arguments.
    """
    words = [sys.executable, '-m', 'incremental_mapper.ros.node', '--ros-args']
    for file in files:
        words += ['--params-file', str(file)]
    for name, value in (parameters or {}).items():
        words += ['-p', f'{name}:={value}']
    return words


def player_command(bag: Path, *options: object) -> list[str]:
    """``incremental_mapper play`` of a bag."""
    words = [sys.executable, '-m', 'incremental_mapper.cli.main', 'play', str(bag)]
    return words + [str(option) for option in options]


def without_ros(error: ImportError, name: str) -> BaseException:
    """What to raise where ROS cannot be imported.

    Args:
        error: What was raised.
        name: The module's ``__name__``; a program ends with one line.
    """
    line = f'needs rclpy and messages, which cannot be imported ({error}); {INSTALL}'
    if name == '__main__':
        return SystemExit(f'{NODE_NAME}: {line}')
    return ImportError(f'{name} {line}', name=error.name, path=error.path)


@contextmanager
def running(
    command: Sequence[str],
    environment: Mapping[str, str],
    stdout: Output = None,
    stderr: Output = None,
) -> Iterator['subprocess.Popen[str]']:
    """Run a program while the block runs; behind it, it is asked to end, then made to.

    Args:
        command: program and arguments.
        environment: its environment variables.
        stdout: where its output goes.
        stderr: where its errors go.

    Yields:
        The process, without input.
    """
    process = subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            try:
                process.communicate(timeout=_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()
