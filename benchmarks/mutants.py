"""Mutation testing: puts small faults into the core rooms and counts those that a test notices.

    python benchmarks/mutants.py OUT [--room NAME ...] [--per-room N] [--seed N] [--jobs N]

The tests of the rooms run once, and it is written down which functions each of them calls. Then
every fault gets a process of its own: a fork of this one, which holds the libraries but nothing of
the package. It reads the one file with the fault in it, all others from the checkout, and runs
the tests that call the function, quickest first, until one fails. No file of the checkout is
touched. ``--per-room`` faults are drawn from all that are possible in a room; 0 takes them all.
Tests that need more than SLOW seconds take no part. OUT gets ``mutants.csv`` with every fault and
the test that noticed it, and ``summary.md`` with the share by room and the faults that nobody
noticed. A second call goes on where the first one ended.
"""

import argparse
import csv
import json
import os
import random
import resource
import shutil
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from itertools import zip_longest
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from mutate import Mutant, mutants_of

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'incremental_mapper'
ROOMS: dict[str, list[str]] = {
    'candidates': ['candidates/*.py'],
    'graph': ['graph/*.py'],
    'scoring': ['scoring/*.py'],
    'smoothing': ['smoothing/*.py'],
    'selection': ['selection/*.py'],
    'frontend': ['frontend/*.py'],
    'mapping': [f'mapping/{name}.py' for name in ('window_buffer', 'commit', 'georeferencing')],
}
TESTS = [f'test/{room}' for room in ROOMS]
SLOW = 20.0
"""Seconds of the processor while calls are written down, which makes everything slower;
a test that takes longer tells of faults that a quicker one should have noticed."""
PATIENCE = 15.0
"""Seconds of the processor beyond twice what the tests take; after that a fault hangs, and is
noticed. One that waits for ever is given four times as long by the clock."""
FEW = 5
EXAMPLES = 25
"""Examples of a property at the most: a fault that needs more to show is not noticed surely."""
MEMORY = 8 << 30
LIBRARIES = (
    'gtsam hypothesis.strategies kiss_icp.config numba numpy pydantic.main pymap3d pytest '
    'rosbags.highlevel rosbags.rosbag1 rosbags.rosbag2 scipy.linalg.lapack '
    'scipy.spatial.transform small_gicp threadpoolctl tqdm yaml'
)
FIELDS = ('id', 'room', 'file', 'line', 'function', 'kind', 'before', 'after')
OUTCOME = ('status', 'test', 'seconds')


@dataclass(frozen=True)
class Trace:
    """Seconds of every test, and the functions that it calls, as ``file:qualified.name``."""

    seconds: dict[str, float]
    calls: dict[str, list[str]]

    def tests(self, mutant: Mutant) -> list[str]:
        """Tests that may notice a fault, quickest first.

        Where few call the function, the others of their files follow: some share what was made
        once, and only the first one of them was seen to call it.
        """
        inside = f'{mutant.file}:{mutant.function}'
        of_file = {name for name in self.seconds if self._touches(name, f'{mutant.file}:')}
        # Compiled functions are not seen when they are called, nor is what runs on import.
        called = {name for name in of_file if self._touches(name, inside)} or of_file
        files = {name.split('::')[0] for name in called} if len(called) < FEW else set()
        rest = {name for name in self.seconds if name.split('::')[0] in files} - called
        return [
            *sorted(called, key=self.seconds.__getitem__),
            *sorted(rest, key=self.seconds.__getitem__),
        ]

    def _touches(self, test: str, prefix: str) -> bool:
        return any(call.startswith(prefix) for call in self.calls[test])


class Recorder:
    """A pytest plugin that writes down what every test calls in the package."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._began = 0.0
        self.calls: dict[str, set[str]] = defaultdict(set)
        self.failed: set[str] = set()
        self._of_fixture: dict[Any, set[str]] = defaultdict(set)
        self._codes: dict[CodeType, str | None] = {}
        self._sinks: list[set[str]] = []

    def _profile(self, frame: FrameType, event: str, argument: Any) -> None:
        if event != 'call':
            return
        code = frame.f_code
        if code not in self._codes:
            inside = code.co_filename.startswith(f'{ROOT}/{PACKAGE}/')
            name = code.co_qualname.replace('<locals>.', '').split('.<')[0]
            place = Path(code.co_filename).relative_to(ROOT) if inside else None
            self._codes[code] = f'{place}:{name}' if inside else None
        call = self._codes[code]
        if call is not None:
            for sink in self._sinks:
                sink.add(call)

    def pytest_runtest_protocol(self, item: Any) -> None:
        """Begin anew with this test."""
        self._began = time.process_time()
        self._sinks = [self.calls[item.nodeid]]
        sys.setprofile(self._profile)

    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
        """What a shared fixture calls counts for every test that has it."""
        self._sinks.append(self._of_fixture[fixturedef])

    def pytest_runtest_logreport(self, report: Any) -> None:
        """What failed without a fault is of no use."""
        if report.failed:
            self.failed.add(report.nodeid)

    def pytest_runtest_call(self, item: Any) -> None:
        """All fixtures are there: their calls are this test's too."""
        del self._sinks[1:]
        for definitions in item._fixtureinfo.name2fixturedefs.values():
            for definition in definitions:
                self.calls[item.nodeid] |= self._of_fixture[definition]

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """The end of this test."""
        sys.setprofile(None)
        self.seconds[nodeid] = time.process_time() - self._began


class Ranked:
    """A pytest plugin that runs the tests of a list in its order, and tells which one failed."""

    def __init__(self, tests: list[str], told: Path) -> None:
        self._rank = {name: place for place, name in enumerate(tests)}
        self._told = told

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Sort, and leave out what is not on the list."""
        from hypothesis import settings

        items[:] = sorted(
            (item for item in items if item.nodeid in self._rank),
            key=lambda item: self._rank[item.nodeid],
        )
        for item in items:
            chosen = getattr(item.obj, '_hypothesis_internal_use_settings', None)
            if chosen is not None and chosen.max_examples > EXAMPLES:
                test = getattr(item.obj, '__func__', item.obj)
                test._hypothesis_internal_use_settings = settings(chosen, max_examples=EXAMPLES)

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Keep the name of the first one that fails."""
        if report.failed and not self._told.exists():
            self._told.write_text(report.nodeid)


class OneFile(MetaPathFinder):
    """Finds one module of the package in another file."""

    def __init__(self, module: str, path: Path) -> None:
        self._module, self._path = module, path

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """See MetaPathFinder."""
        if name != self._module:
            return None
        return spec_from_file_location(name, self._path)


def pytest_in_child(work: Path, arguments: list[str], plugin: Any) -> int:
    """Run pytest in this process, whose output goes to a file; returns its exit status."""
    import pytest
    from hypothesis import Phase, settings

    # To make a failing example smaller takes longer than to find it.
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile('faults', phases=phases, derandomize=True, database=None)
    work.mkdir(parents=True, exist_ok=True)
    output = os.open(work / 'output.txt', os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.chdir(ROOT)
    common = [
        '-q',
        '-p',
        'no:cacheprovider',
        '--hypothesis-profile=faults',
        '--no-header',
        f'--basetemp={work / "tmp"}',
    ]
    status = int(pytest.main([*common, *arguments], plugins=[plugin]))
    sys.stdout.flush()
    return status


def fork(work: Callable[[], int]) -> int:
    """The id of a child, the leader of a group of its own, that does the work and is gone."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        os.setsid()
        status = work()
    finally:
        os._exit(status)


def record(out: Path) -> Trace:
    """Run the tests once; those that fail without a fault take no part."""

    def work() -> int:
        recorder = Recorder()
        pytest_in_child(out / 'trace', ['--continue-on-collection-errors', *TESTS], recorder)
        usable = {
            name: seconds
            for name, seconds in recorder.seconds.items()
            if name not in recorder.failed and seconds < SLOW
        }
        tree = {
            'seconds': usable,
            'calls': {name: sorted(recorder.calls[name]) for name in usable},
            'failed': sorted(recorder.failed),
        }
        (out / 'trace.json').write_text(json.dumps(tree, indent=1))
        return 0

    path = out / 'trace.json'
    if not path.exists():
        os.waitpid(fork(work), 0)
    tree = json.loads(path.read_text())
    for name in tree['failed']:
        print(f'note: {name} fails without any fault and is left out', file=sys.stderr)
    return Trace(tree['seconds'], tree['calls'])


def try_mutant(mutant: Mutant, tests: list[str], work: Path, seconds: int) -> int:
    """In a child: run the tests with the fault in place; 0 where none of them notices."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    work.mkdir(parents=True, exist_ok=True)
    path = work / Path(mutant.file).name
    path.write_bytes(mutant.applied((ROOT / mutant.file).read_bytes()))
    module = mutant.file.removesuffix('.py').replace('/', '.').removesuffix('.__init__')
    sys.meta_path.insert(0, OneFile(module, path))
    # The module's own tests first: others need not even be imported where these notice it.
    own = f'test/{mutant.file.split("/")[1]}/test_{path.name}'
    near = [name for name in tests if name.startswith(own)]
    for some in (near, [name for name in tests if name not in near]):
        if some:
            files = sorted({name.split('::')[0] for name in some})
            status = pytest_in_child(work, ['-x', *files], Ranked(some, work / 'noticed.txt'))
            if status:
                return status
    return 0


def run(
    mutants: list[tuple[str, Mutant]], trace: Trace, out: Path, jobs: int
) -> Iterator[dict[str, Any]]:
    """Try faults, some at a time; yields a row of the table for each that is done."""
    waiting = list(enumerate(mutants))[::-1]
    running: dict[int, tuple[str, Mutant, Path, float, float]] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            number, (room, mutant) = waiting.pop()
            tests = trace.tests(mutant)
            work = out / 'work' / str(number)
            if not tests:
                yield row(room, mutant, 'no test', '', 0.0)
                continue
            limit = round(PATIENCE + 2.0 * sum(trace.seconds[name] for name in tests))
            child = fork(partial(try_mutant, mutant, tests, work, limit))
            running[child] = room, mutant, work, time.monotonic(), 4.0 * limit
        time.sleep(0.02)
        for child, (room, mutant, work, began, limit) in list(running.items()):
            ended, status, used = os.wait4(child, os.WNOHANG)
            if not ended and time.monotonic() - began < limit:
                continue
            if not ended:
                os.killpg(child, signal.SIGKILL)
                _, _, used = os.wait4(child, 0)
            spent = used.ru_utime + used.ru_stime
            told = work / 'noticed.txt'
            test = told.read_text() if told.exists() else ''
            code = os.waitstatus_to_exitcode(status) if ended else -signal.SIGKILL
            if code in (-signal.SIGKILL, -signal.SIGXCPU):
                word = 'hangs'
            elif code == 0:
                word = 'survived'
            else:
                word = 'killed' if test else 'crashed'
            del running[child]
            if word != 'crashed':
                shutil.rmtree(work, ignore_errors=True)
            yield row(room, mutant, word, test, spent)


def row(room: str, mutant: Mutant, status: str, test: str, seconds: float) -> dict[str, Any]:
    """A line of the table."""
    one_line = {name: ' '.join(getattr(mutant, name).split()) for name in ('before', 'after')}
    whole = {name: getattr(mutant, name) for name in FIELDS if name != 'room'} | one_line
    return {'room': room, **whole, 'status': status, 'test': test, 'seconds': f'{seconds:.2f}'}


def chosen(rooms: list[str], per_room: int, seed: int) -> list[tuple[str, Mutant]]:
    """The faults to try: the same ones for the same seed and code."""
    by_room: list[list[tuple[str, Mutant]]] = []
    for room in rooms:
        possible: list[Mutant] = []
        for pattern in ROOMS[room]:
            for path in sorted((ROOT / PACKAGE).glob(pattern)):
                possible += mutants_of(str(path.relative_to(ROOT)), path.read_bytes())
        print(f'{room}: {len(possible)} faults are possible', file=sys.stderr)
        if 0 < per_room < len(possible):
            possible = random.Random(f'{seed} {room}').sample(possible, per_room)
        by_room.append([(room, mutant) for mutant in possible])
    # In turn, so that a run that is ended early has tried as many in each room.
    turns = zip_longest(*by_room)
    return [pair for turn in turns for pair in turn if pair is not None]


def summary(rows: list[dict[str, str]]) -> str:
    """Kill rate by room, and the faults that nobody noticed, in Markdown."""
    lines = ['| Room | Faults | Noticed | Rate |', '|---|---:|---:|---:|']
    for room in ROOMS:
        own = [item for item in rows if item['room'] == room]
        if own:
            noticed = sum(item['status'] in ('killed', 'hangs', 'crashed') for item in own)
            rate = 100.0 * noticed / len(own)
            lines.append(f'| {room} | {len(own)} | {noticed} | {rate:.0f} % |')
    lines += ['', '| Place | Function | Was | Became |', '|---|---|---|---|']
    for item in rows:
        if item['status'] in ('survived', 'no test'):
            cells = (f'{item["file"]}:{item["line"]}', item['function'])
            before, after = (item[name].replace('|', '\\|') for name in ('before', 'after'))
            lines.append(f'| {cells[0]} | {cells[1]} | `{before}` | `{after}` |')
    return '\n'.join(lines) + '\n'


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('out', type=Path)
    parser.add_argument('--room', action='append', choices=ROOMS, help='only this room')
    parser.add_argument('--per-room', type=int, default=60, help='faults drawn in each; 0: all')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--jobs', type=int, default=1, help='faults that are tried at a time')
    args = parser.parse_args()
    for name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'NUMBA_NUM_THREADS'):
        os.environ[name] = '1'
    sys.path[:0] = [str(ROOT)]
    out = args.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for name in LIBRARIES.split():
        __import__(name)
    trace = record(out)
    table = out / 'mutants.csv'
    known: dict[str, dict[str, str]] = {}
    if table.exists():
        with table.open(newline='') as file:
            known = {item['id'] + item['after']: item for item in csv.DictReader(file)}
    mutants = chosen(args.room or list(ROOMS), args.per_room, args.seed)
    rows = [known[item.id + item.after] for _, item in mutants if item.id + item.after in known]
    fresh = [pair for pair in mutants if pair[1].id + pair[1].after not in known]
    with table.open('a', newline='') as file:
        writer = csv.DictWriter(file, [*FIELDS, *OUTCOME])
        if not known:
            writer.writeheader()
        for done, item in enumerate(run(fresh, trace, out, args.jobs), 1):
            writer.writerow(item)
            file.flush()
            rows.append({name: str(value) for name, value in item.items()})
            print(f'{done}/{len(fresh)} {item["status"]}: {item["id"]}', file=sys.stderr)
    (out / 'summary.md').write_text(summary(rows))
    print(summary(rows))


if __name__ == '__main__':
    main()
