"""Saving while the robot drives, while somebody ends the node, and where the disk is full."""

import atexit
import resource
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from long_drive import RepeatedDrive
from node_runs import PATIENCE, SEED, Drive, make_drive

from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.measurements import NANOSECONDS, ImuSample
from incremental_mapper.results.offline_run import effective_config
from incremental_mapper.results.run_folder import FILES, FinishedRun
from incremental_mapper.ros.client import NodeClient, open_client
from incremental_mapper.ros.inbox import Command, Order
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    player_command,
    running,
)
from incremental_mapper.ros.updates import Reply, WindowUpdate
from incremental_mapper.ros.worker import Worker
from incremental_mapper.settings import merge
from robot_rows import Seen, row

SECONDS = 12.0
"""Of the short drives."""
ROUNDS, ROUND = 10, 60.0
"""Of the long drive: ten minutes."""
WAITING = 20
"""Scans that may wait while the long map is made as fast as it goes."""


@dataclass(slots=True)
class Trial:
    """A node that has mapped a drive, and a client of it."""

    process: 'subprocess.Popen[str]'
    client: NodeClient
    drive: Drive
    environment: dict[str, str]
    log: Path

    def play(self, *options: object) -> None:
        """Play the drive, and wait until it is mapped."""
        command = player_command(self.drive.bag, '--wait', PATIENCE, *options)
        subprocess.run(
            command,
            env=self.environment,
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        time.sleep(1.0)
        self.client.call('flush', PATIENCE)

    def limit_files(self, size: int) -> None:
        """No file of the node becomes larger from now on, as on a disk that is full."""
        hard = resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE)[1]
        resource.prlimit(self.process.pid, resource.RLIMIT_FSIZE, (size, hard))

    def end(self) -> int:
        """Ctrl-C; returns the exit status."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(PATIENCE)


@cache
def short_drive() -> Drive:
    """A drive for all rows that need no long one, simulated once."""
    folder = tempfile.mkdtemp(prefix='robot_drive_')
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return make_drive(Path(folder), SECONDS, Path('config/kaist.yaml'))


@contextmanager
def trial(folder: Path, **parameters: object) -> Iterator[Trial]:
    """A node that saves below ``folder``."""
    drive = short_drive()
    environment = local_environment(domain := free_domain())
    given = {
        'diagnostics.period': 0.2,
        'save.on_shutdown': folder / 'last',
        'save.folder': folder / 'saved',
        **{name.replace('__', '.'): value for name, value in parameters.items()},
    }
    log = folder / 'node.log'
    with (
        log.open('w') as file,
        running(node_command(drive.settings, given), environment, file, file) as node,
        open_client(domain) as client,
    ):
        client.wait(
            lambda: bool(client.diagnostics), 'the node', PATIENCE, lambda: node.poll() is None
        )
        yield Trial(node, client, drive, dict(environment), log)


def complete(folder: Path) -> bool:
    """Whether all data of a map are there and can be read."""
    if not all((folder / name).is_file() for name in FILES):
        return False
    run = FinishedRun(folder)
    return len(run.points) > 0 and len(run.trajectory.stamps) == len(run.graph['clusters'])


def savers(node: int) -> list[int]:
    """Processes that save for a node: forks of it, with a session of their own."""
    found = []
    own = Path(f'/proc/{node}/cmdline').read_bytes()
    for task in Path(f'/proc/{node}/task').iterdir():
        for child in (task / 'children').read_text(encoding='ascii').split():
            fields = Path(f'/proc/{child}/stat').read_text(encoding='ascii').rpartition(')')[2]
            if fields.split()[3] == child and Path(f'/proc/{child}/cmdline').read_bytes() == own:
                found.append(int(child))
    return found


def wait_until(condition: Callable[[], object], seconds: float) -> bool:
    """Wait for something; returns whether it came."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


@row('the map stayed in a hidden folder')
def killed(folder: Path) -> Seen:
    """SIGINT, and SIGKILL as soon as the node has begun to save."""
    with trial(folder) as run:
        run.play()
        run.process.send_signal(signal.SIGINT)
        begun = wait_until(lambda: savers(run.process.pid), 30.0)
        before = (folder / 'last').exists()
        run.process.kill()
        run.process.wait()
        stands = wait_until((folder / 'last').exists, 120.0)
    whole = stands and complete(folder / 'last')
    drawn = wait_until((folder / 'last' / 'graph.png').exists, 120.0)
    said = 'complete' if whole else 'not complete'
    when = 'after' if begun and not before else 'before'
    pictures = 'came' if drawn else 'are missing'
    return Seen(
        f'the folder is {said}, it stood {when} the kill; pictures {pictures}',
        whole and drawn and when == 'after',
    )


@row('map lost with exit status 0')
def disk_full(folder: Path) -> Seen:
    """The disk fills up before the node is ended, and the fallback with it."""
    with trial(folder, save__fallback=folder / 'else') as run:
        run.play()
        success, message = run.client.call('save_map', PATIENCE)
        sizes = {name: (folder / 'saved' / name).stat().st_size for name in FILES}
        run.limit_files(max(size for name, size in sizes.items() if name != 'map.ply') + 50_000)
        status = run.end()
    part = folder / 'last_incomplete'
    there = sorted(path.name for path in part.iterdir()) if part.is_dir() else []
    graph = FinishedRun(part).graph if there else {}
    same = graph == FinishedRun(folder / 'saved').graph
    points = {'map.ply'}
    right = set(FILES) - points <= set(there) and not points & set(there)
    ok = success and status == 1 and right and same
    return Seen(
        f'{message}; then exit status {status}, saved without points: {", ".join(there)}', ok
    )


@row('map lost with exit status 0')
def fallback(folder: Path) -> Seen:
    """The wanted folder cannot be made when the node is ended."""
    (folder / 'file').touch()
    wanted = folder / 'file' / 'last'
    with trial(folder, save__on_shutdown=wanted, save__fallback=folder / 'else') as run:
        run.play()
        status = run.end()
        said = [line for line in run.log.read_text().splitlines() if 'saved to' in line]
    whole = complete(folder / 'else' / 'last')
    where = 'in the fallback' if whole else 'nowhere'
    return Seen(f'exit status {status}, complete {where}', status == 1 and whole and bool(said))


@row('exit status 0')
def nothing_mapped(folder: Path) -> Seen:
    """A node that heard nothing is ended, and was to save."""
    with trial(folder) as run:
        status = run.end()
    return Seen(f'exit status {status}', status == 1)


@row('map discarded, saving raises KeyError')
def store_full(folder: Path) -> Seen:
    """The disk of map.store fills up in the middle of a drive."""
    store = folder / 'store'
    store.mkdir()
    with trial(folder, map__store='disk', map__store_folder=store) as run:
        half = SECONDS / 2
        run.play('--duration', half)
        run.limit_files(1_000_000)
        run.play('--start', half)
        failures = run.client.fresh_diagnostics()['worker']['mapper_failures']
        resource.prlimit(
            run.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        )
        success, message = run.client.call('save_map', PATIENCE)
    saved = FinishedRun(folder / 'saved')
    rules = [item['rule'] for item in saved.stats['warnings']]
    seconds = (saved.last_stamp - saved.first_stamp) / NANOSECONDS
    ok = failures == 0 and success and 'store_full' in rules and seconds > SECONDS - 2.0
    return Seen(
        f'{failures} failures, a map of {seconds:.0f} of {SECONDS:.0f} s with {len(saved.points)} '
        f'points; {message}',
        ok and complete(folder / 'saved'),
    )


@row('stood still for 5 s', long=True)
def driving(folder: Path) -> Seen:
    """save_map of a map of ten minutes while the drive goes on at 10 Hz."""
    if not (folder / 'drive').exists():
        options = SimulationOptions(motion=MotionKind.MIXED, duration=ROUND, seed=SEED)
        simulate(folder / 'drive', options, None)
    tree = {'save': {'folder': str(folder / 'saved')}, 'queue': {'core': 100_000}}
    source = open_source(folder / 'drive', {})
    config = effective_config(source, merge({}, tree), 'trial')
    latest: dict[int, float] = {}
    told: list[tuple[float, object]] = []
    worker = Worker(config, lambda update: told.append((time.monotonic(), update)))
    worker.start()
    spans = [0.0]

    def paced() -> None:
        begin: tuple[float, int] | None = None
        first: int | None = None
        asked = False
        for item in RepeatedDrive(source, ROUNDS).measurements():
            first = item.stamp if first is None else first
            passed = (item.stamp - first) / NANOSECONDS
            if passed < (ROUNDS - 1) * ROUND:
                while not isinstance(item, ImuSample) and worker.inbox.waiting()[0] > WAITING:
                    time.sleep(0.005)
            else:
                if begin is None:
                    while worker.inbox.waiting()[0]:
                        time.sleep(0.01)
                    begin = time.monotonic(), item.stamp
                due = begin[0] + (item.stamp - begin[1]) / NANOSECONDS
                time.sleep(max(due - time.monotonic(), 0.0))
                latest[item.stamp] = time.monotonic()
                if not asked and time.monotonic() - begin[0] > 20.0:
                    asked = True
                    spans[0] = time.monotonic()
                    worker.inbox.put(Command(Order.SAVE, 1))
            worker.inbox.put(item)

    paced()
    wait_until(lambda: any(isinstance(item, Reply) for _, item in list(told)), PATIENCE)
    (answered, reply), *_ = [pair for pair in told if isinstance(pair[1], Reply)]
    worker.begin_stop(60.0)
    worker.join()
    stamps = np.array(sorted(latest))
    late: list[tuple[float, float]] = []
    for when, update in told:
        if isinstance(update, WindowUpdate) and update.result.end > stamps[0]:
            place = np.searchsorted(stamps, update.result.end) - 1
            late.append((when, when - latest[int(stamps[place])]))
    before = [delay for when, delay in late if when < spans[0]]
    during = [delay for when, delay in late if spans[0] <= when <= answered]
    added = max(during) - max(before)
    quantiles = [float(np.quantile(part, 0.5)) for part in (before, during)]
    return Seen(
        f'{reply.message} after {answered - spans[0]:.0f} s; windows came {quantiles[0]:.3f} s '
        f'(worst {max(before):.3f}) after their end before it and {quantiles[1]:.3f} s (worst '
        f'{max(during):.3f}) during it, of {config.window.duration:g} s each',
        reply.success and added <= config.window.duration and complete(folder / 'saved'),
    )
