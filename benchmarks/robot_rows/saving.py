"""Saving while the robot drives, while somebody ends the node, and where the disk is full."""

import atexit
import math
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from subprocess import DEVNULL

from graph_memory import children
from long_drive import write_repeated
from node_runs import PATIENCE, SEED, START, Drive, make_drive

from incremental_mapper.config import Config
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.simulated.folder import simulate
from incremental_mapper.datasets.simulated.options import MotionKind, SimulationOptions
from incremental_mapper.errors import InputError
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.file_names import FILES
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.ros.client import Heard, NodeClient, open_client
from incremental_mapper.ros.programs import (
    free_domain,
    local_environment,
    node_command,
    player_command,
    running,
)
from incremental_mapper.settings import read_yaml
from robot_rows import Seen, row

CONFIG = Path(__file__).parents[2] / 'config' / 'kaist.yaml'
SECONDS = 12.0
"""Of the short drives."""
ROUNDS, ROUND = 10, 60.0
"""Of the long drive: ten minutes."""
SETTLED = 15.0
"""Seconds of driving before the save, with which the windows during it are compared."""
HASTE = 4
"""How many times faster than it was driven the map of the long drive is begun; much faster, and
clouds fall behind the small messages by more than ``window.lateness``."""
GRACE = 5.0
"""Seconds that ``ros2 launch`` gives a program after SIGINT, and after SIGTERM."""


@dataclass(slots=True)
class Trial:
    """A node that has mapped a drive, and a client of it."""

    process: 'subprocess.Popen[str]'
    client: NodeClient
    drive: Drive
    environment: dict[str, str]
    log: Path

    def player(self, *options: object) -> list[str]:
        """The program that plays the drive."""
        return player_command(self.drive.bag, '--wait', PATIENCE, *options)

    def send(self, *options: object) -> None:
        """Play the drive."""
        subprocess.run(
            self.player(*options), env=self.environment, check=True, stdout=DEVNULL, stderr=DEVNULL
        )

    def play(self, *options: object) -> None:
        """Play the drive, and wait until it is mapped."""
        self.send(*options)
        time.sleep(1.0)
        self.client.call('flush', PATIENCE)

    def catch_up(self) -> None:
        """Wait until no scan waits for the mapper."""
        while self.client.fresh_diagnostics(PATIENCE)['worker']['queue_core'] > 0:
            pass

    def samples(self) -> int:
        """How many IMU samples have come."""
        received: int = self.client.fresh_diagnostics(PATIENCE)['imu']['received']
        return received

    def try_save(self) -> None:
        """Call save_map of a node that may end before it answers."""
        with suppress(InputError):
            self.client.call('save_map', PATIENCE)

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
    return make_drive(Path(folder), SECONDS, CONFIG)


@contextmanager
def trial(folder: Path, drive: Drive | None = None, **parameters: object) -> Iterator[Trial]:
    """A node that saves below ``folder``, for the short drive or another one."""
    drive = drive or short_drive()
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
    # Where the vehicle stood, more stamps than clusters have a pose.
    return len(run.points) > 0 and len(run.trajectory.stamps) >= len(run.graph['clusters'])


def savers(node: int) -> list[int]:
    """Processes that save for a node: forks of it, with a session of their own."""
    found = []
    own = Path(f'/proc/{node}/cmdline').read_bytes()
    for child in children(node):
        with suppress(OSError):  # it may end while it is looked at
            fields = Path(f'/proc/{child}/stat').read_text(encoding='ascii').rpartition(')')[2]
            same = Path(f'/proc/{child}/cmdline').read_bytes() == own
            if int(fields.split()[3]) == child and same:
                found.append(child)
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
    points = {'map.ply', 'files.json'}
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


def long_drive(folder: Path, rounds: int) -> Drive:
    """A bag of so many minutes below ``folder``, as one drive."""
    options = SimulationOptions(motion=MotionKind.MIXED, duration=ROUND, seed=SEED)
    simulate(folder / 'minute', options, None)
    write_repeated(folder / 'minute', folder / 'bag', rounds)
    shutil.rmtree(folder / 'minute')
    info = open_source(folder / 'bag', read_yaml(CONFIG)).info
    return Drive(
        folder / 'bag', (folder / 'bag' / SETTINGS_FILE, CONFIG), info.counts, info.duration
    )


def save_while_driving(folder: Path, rounds: int) -> Seen:
    """Map all rounds but the last as fast as it goes and the last in real time, and save in it.

    Then the node is ended as ``ros2 launch`` does by default, in the middle of another save.
    """
    drive = long_drive(folder, rounds)
    last = (rounds - 1) * ROUND
    waiting = {'queue.core': 100_000, 'queue.imu': 1_000_000, 'queue.max_delay': 0.0}
    with trial(folder, drive, **waiting) as run:
        run.send('--duration', last, '--rate', HASTE)
        run.catch_up()
        heard = run.samples()
        with running(run.player('--start', last), run.environment, DEVNULL, DEVNULL) as player:
            # The player takes seconds to begin, and windows of what was sent before may still come.
            wait_until(lambda: run.samples() > heard, START)
            begin = len(run.client.odometry)
            time.sleep(SETTLED)
            asked = time.time_ns()
            answers: list[tuple[bool, str, int]] = []
            saving = threading.Thread(
                target=lambda: answers.append(
                    (*run.client.call('save_map', PATIENCE), time.time_ns())
                ),
                daemon=True,
            )
            saving.start()
            wait_until(lambda: player.poll() is not None, 2.0 * ROUND)
            stopped = time.time_ns()
        saving.join()
        run.catch_up()
        ((success, message, answered),) = answers
        lags = window_lags(run.client.odometry[begin:])
        before = [lag for sent, lag in lags if sent < asked]
        # The last windows of a drive close when nothing more has come for a while.
        during = [lag for sent, lag in lags if asked <= sent <= min(answered, stopped)]
        seconds = (answered - asked) / NANOSECONDS
        clusters = run.client.stats[-1]['clusters']
        ended, stands = end_as_launch(run, folder)
    whole = {name: complete(folder / name) for name in ('saved', 'saved_2', 'last')}
    all_there = whole['last'] and len(FinishedRun(folder / 'last').graph['clusters']) >= clusters
    worst = max(during, default=math.inf)  # where none came at all
    added = worst - max(before)
    duration = Config().window.duration
    behind = '' if answered < stopped else ', when the drive was over'
    return Seen(
        f'{message} after {seconds:.1f} s{behind}; windows came at most {max(before):.3f} s later '
        f'than the earliest one before it, {worst:.3f} s during it, of {duration:g} s each; then '
        f'{ended}; the save under way and the last one stood {stands} after SIGINT; complete: '
        f'{", ".join(name for name, ok in whole.items() if ok) or "none"}, '
        f'{clusters} clusters {"all there" if all_there else "NOT all there"}',
        success and added <= duration and all(whole.values()) and all_there,
    )


def window_lags(heard: Sequence[Heard]) -> list[tuple[int, float]]:
    """When each window was published (ns), and how much later after its stamp than the earliest."""
    stamps = [item.message.header.stamp for item in heard]
    late = [
        item.sent - stamp.sec * NANOSECONDS - stamp.nanosec
        for item, stamp in zip(heard, stamps, strict=True)
    ]
    return [
        (item.sent, (lag - min(late)) / NANOSECONDS) for item, lag in zip(heard, late, strict=True)
    ]


def end_as_launch(run: Trial, folder: Path) -> tuple[str, str]:
    """SIGINT in the middle of a save, SIGTERM 5 s and SIGKILL 10 s later.

    Returns:
        What ended the node, and when the two maps stood.
    """
    call = threading.Thread(target=run.try_save, daemon=True)
    call.start()
    wait_until(lambda: savers(run.process.pid), START)
    begin = time.monotonic()
    ended = 'it ended by itself after SIGINT'
    for number, name in (
        (signal.SIGINT, ''),
        (signal.SIGTERM, 'SIGTERM ended it'),
        (signal.SIGKILL, 'it was killed'),
    ):
        ended = name or ended
        run.process.send_signal(number)
        if wait_until(lambda: run.process.poll() is not None, GRACE):
            break
    ended += f' after {time.monotonic() - begin:.1f} s'
    stood = []
    for name in ('saved_2', 'last'):
        there = wait_until((folder / name).exists, PATIENCE)
        stood.append(f'{time.monotonic() - begin:.1f} s' if there else 'never')
    return ended, ' and '.join(stood)


@row('stood still for 5 s; a larger map stayed in a hidden folder', long=True)
def driving(folder: Path) -> Seen:
    """save_map of a 10-minute map while driving; then SIGINT in a save, SIGTERM, SIGKILL."""
    return save_while_driving(folder, ROUNDS)


@row('the same', long=True)
def driving_shorter(folder: Path) -> Seen:
    """save_map of a 2-minute map while driving; then SIGINT in a save, SIGTERM, SIGKILL."""
    return save_while_driving(folder, 2)
