"""Recordings that lie: makes them, maps each by the command line, and says who was told.

    python benchmarks/field.py [NAME ...] [--timed] [--jobs N] [--out FOLDER] [--list]
    python benchmarks/field.py --external FOLDER
    python benchmarks/field.py --clean INPUT[@CONFIG] ...

Every generator of the package ``lies`` harms a simulated drive of five seconds; the same drive
unharmed is mapped in the same run, and is what the others are measured against. A row tells the
situation, the exit status, the rules that were found, the errors, and the verdict:

as expected   sound, mended, warned of or refused, as the generator says
SILENT        harmed, and nothing was said that is about it
NOT MENDED    said, but the map is worse than where it is mended
false alarm   sound, and a warning nevertheless
CRASH         a traceback, or an end without a message

The exit status is 1 where anything is silent or crashed. ``--timed`` gives the points of all
drives their times, so that sweeps are deskewed by whatever the IMU says. ``--external`` maps all
inputs under a folder, with each settings file that lies beside them: what is right there is for the
reader to judge. ``--clean`` maps sound inputs and lists their warnings, none of which should be
untrue.
"""

import argparse
import json
import multiprocessing
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from lies import (  # noqa: F401
    bags,
    clocks,
    clouds,
    conventions,
    conversions,
    faint,
    fixes,
    frames,
    hardware,
    inertial,
    leaps,
    mixtures,
    pulls,
    rigs,
    sensors,
    surprises,
    sweeps,
)
from lies.lie import LIES, Lie, Verdict
from lies.recording import DRIVES, Recording, make_drive

from incremental_mapper.cli import convert, map_drive  # noqa: F401  so that forks have them
from incremental_mapper.cli.main import main as command_line
from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.trajectory import match_truth, read_tum

SLACK = 0.02
"""Metres of ATE beyond the factor, and ..."""
LEANING = 1.0
"""... degrees of the vertical beyond the unharmed drive's, that a good map may have."""
WRONG = 1.0
"""Metres of ATE from which a map is wrong, whatever is said of it: exit status 0 is not for it."""
FORKS = multiprocessing.get_context('forkserver')
FORKS.set_forkserver_preload([Path(__file__).stem])
PATIENCE = 900.0
"""Seconds after which a run counts as hung."""
SILENT, NOT_MENDED, FALSE, CRASH, FINE = (
    'SILENT',
    'NOT MENDED',
    'false alarm',
    'CRASH',
    'as expected',
)


@dataclass(frozen=True)
class Outcome:
    """What one ``map`` did, as a user sees it.

    ``errors`` are ATE in metres and the mean angle between the true and the mapped vertical in
    degrees; None without a map or without truth.
    """

    status: int
    printed: str
    stats: dict[str, Any] | None
    errors: tuple[float, float] | None
    seconds: float

    @property
    def rules(self) -> list[str]:
        """The rules that found something, with the sign of their severity."""
        signs = {'mended': '~', 'warning': '', 'error': '!'}
        found = (self.stats or {}).get('warnings', [])
        return [f'{signs[item["severity"]]}{item["rule"]}' for item in found]

    @property
    def said(self) -> list[str]:
        """Everything that was said of the input: warnings, and lines of the terminal."""
        found = (self.stats or {}).get('warnings', [])
        lines = [' '.join(str(part) for part in item.values()) for item in found]
        if self.status != 0:
            lines += self.printed.splitlines()
        return lines

    @property
    def crashed(self) -> bool:
        """Whether it ended as no program should."""
        spoken = 'incremental_mapper: ' in self.printed or self.stats is not None
        return 'Traceback' in self.printed or self.status < 0 or (self.status != 0 and not spoken)


def run_map(source: Path, out: Path, words: Sequence[str] = (), fresh: bool = False) -> Outcome:
    """Map an input by the command line, in a process of its own.

    Starting Python and drawing takes several times as long as mapping five seconds, so the process
    is a fork that has the libraries, and draws nothing, unless a ``fresh`` one is wanted.
    """
    shutil.rmtree(out, ignore_errors=True)
    arguments = ['map', str(source), str(out), *words]
    started = time.perf_counter()
    with tempfile.NamedTemporaryFile('w+') as log:
        if fresh:
            command = [sys.executable, '-m', 'incremental_mapper.cli.main', *arguments]
            process: Any = subprocess.Popen(command, stdout=log, stderr=log)
        else:
            process = FORKS.Process(target=_command, args=(arguments, log.name))
            process.start()
        status = _ended(process)
        log.seek(0)
        printed = log.read().replace(str(source), 'INPUT')
    path = out / 'stats.json'
    stats = json.loads(path.read_text()) if path.exists() else None
    seconds = time.perf_counter() - started
    return Outcome(status, printed, stats, _errors(out, stats, source), seconds)


def _ended(process: Any) -> int:
    """Exit status of a process, killed where it hangs."""
    if isinstance(process, subprocess.Popen):
        try:
            return process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            return -9
    process.join(PATIENCE)
    if process.is_alive():
        process.kill()
        process.join()
    return int(process.exitcode)


def _command(arguments: Sequence[str], log: str) -> None:
    """The command line, in a fork: its text goes to the file ``log``."""
    with Path(log).open('a') as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    sys.stdout = os.fdopen(1, 'w')
    sys.stderr = os.fdopen(2, 'w')
    sys.modules['matplotlib'] = None  # type: ignore[assignment]
    status = 1
    try:
        status = command_line(arguments)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _errors(out: Path, stats: dict[str, Any] | None, source: Path) -> tuple[float, float] | None:
    """ATE, and how far the map leans."""
    if stats is None or 'ate_rmse_m' not in stats:
        return None
    truth = _truth(source)
    if truth is None:
        return stats['ate_rmse_m'], 0.0
    estimate, truth = match_truth(read_tum(out / 'trajectory.tum'), truth)
    if not len(estimate):  # the stamps of all sensors are those of another clock
        return stats['ate_rmse_m'], 0.0
    # The vertical in the car's frame does not depend on where the map's axes point.
    seen, real = (path.rotations().inv().apply([0.0, 0.0, 1.0]) for path in (estimate, truth))
    angles = np.arccos(np.clip((seen * real).sum(axis=1), -1.0, 1.0))
    return stats['ate_rmse_m'], float(np.degrees(angles).mean())


def _truth(source: Path) -> Any:
    """The true poses of a drive, from the KAIST folder that its bag was made of."""
    beside = source.parent / 'truth.csv'
    return read_truth(beside) if beside.exists() else None


def judge(lie: Lie, outcome: Outcome, unharmed: Outcome) -> str:
    """The verdict on one recording, by what may be expected of it."""
    if outcome.crashed:
        return CRASH
    about = re.compile(lie.about or '.', re.IGNORECASE)
    said = any(about.search(line) for line in outcome.said)
    known = {(item['rule'], item['sensor']) for item in unharmed.stats['warnings']}  # type: ignore[index]
    found = (outcome.stats or {}).get('warnings', [])
    alarms = [item for item in found if (item['rule'], item['sensor']) not in known]
    if outcome.status != 0:
        # An error of a map that is there is more than a warning.
        wanted = {Verdict.REFUSED, Verdict.WARNED}
        return FINE if wanted & {*lie.expected} and said else SILENT if not said else FALSE
    good = is_good(lie, outcome, unharmed)
    if Verdict.SOUND in lie.expected and good:
        bad = [item for item in alarms if item['severity'] != 'mended']
        return FALSE if bad and Verdict.WARNED not in lie.expected else FINE
    if Verdict.MENDED in lie.expected and good and said:
        return FINE
    if not said:
        return SILENT
    wrong = outcome.errors is not None and outcome.errors[0] > WRONG
    return FINE if Verdict.WARNED in lie.expected and not wrong else NOT_MENDED


def is_good(lie: Lie, outcome: Outcome, unharmed: Outcome) -> bool:
    """Whether a map is as good as that of the unharmed drive."""
    assert outcome.stats is not None and unharmed.stats is not None
    if outcome.errors is None or unharmed.errors is None:
        return False
    return (
        outcome.errors[0] <= lie.factor * unharmed.errors[0] + SLACK
        and outcome.errors[1] <= unharmed.errors[1] + LEANING
        and outcome.stats['map_points'] >= lie.share * unharmed.stats['map_points']
    )


def row(name: str, situation: str, outcome: Outcome, unharmed: Outcome | None, verdict: str) -> str:
    """One line of the table, in Markdown."""
    ate = '-' if outcome.errors is None else f'{outcome.errors[0]:.3f}'
    if unharmed is not None and unharmed.errors is not None:
        ate += f' / {unharmed.errors[0]:.3f}'
    lean = '-' if outcome.errors is None else f'{outcome.errors[1]:.1f}'
    counts = Counter(outcome.rules)
    rules = ' '.join(f'{rule}' + f' {n}x' * (n > 1) for rule, n in counts.items()) or '-'
    return f'| {name} | {situation} | {outcome.status} | {rules} | {ate} | {lean} | {verdict} |'


HEADER = (
    '| name | situation | status | rules | ATE / unharmed, m | leans, deg | verdict |\n'
    '|---|---|---:|---|---:|---:|---|'
)


def run_lies(names: Sequence[str], work: Path, jobs: int, timed: bool = False) -> int:
    """The table of our own recordings; returns the exit status."""
    unknown = [name for name in names if name not in LIES]
    if unknown:
        print(f'no generator {", ".join(unknown)}; --list names them', file=sys.stderr)
        return 2
    chosen = [LIES[name] for name in names or LIES]
    drives: dict[str, Recording] = {}
    for name in sorted({lie.drive for lie in chosen}):
        kind = replace(DRIVES[name], timed=True) if timed else DRIVES[name]
        drives[name] = make_drive(kind, work / 'drives' / name)
    print(HEADER, flush=True)

    def unharmed_of(name: str) -> Outcome:
        folder = _fresh(work / 'unharmed' / name)
        shutil.copy(drives[name].folder / 'global_pose.csv', folder / 'truth.csv')
        outcome = run_map(drives[name].write(folder / 'bag'), folder / 'out')
        verdict = FINE if outcome.status == 0 and not outcome.rules else FALSE
        print(row(name, 'unharmed', outcome, None, verdict), flush=True)
        return outcome

    verdicts: dict[str, str] = {}
    with ThreadPoolExecutor(jobs) as pool:
        unharmed = dict(zip(drives, pool.map(unharmed_of, drives), strict=True))

        def one(lie: Lie) -> None:
            folder = _fresh(work / 'lies' / lie.name)
            drive = drives[lie.drive]
            shutil.copy(drive.folder / 'global_pose.csv', folder / 'truth.csv')
            source = lie.make(drive, folder)
            outcome = run_map(source, folder / 'out', lie.options)
            (folder / 'printed.txt').write_text(outcome.printed)
            verdicts[lie.name] = judge(lie, outcome, unharmed[lie.drive])
            print(
                row(lie.name, lie.situation, outcome, unharmed[lie.drive], verdicts[lie.name]),
                flush=True,
            )

        list(pool.map(one, chosen))
    counts = Counter(verdicts.values())
    print('\n' + ', '.join(f'{count} {verdict}' for verdict, count in counts.most_common()))
    return 1 if counts[SILENT] or counts[CRASH] else 0


def run_external(folder: Path, work: Path, jobs: int) -> int:
    """The table of recordings made elsewhere, which tell no expectation."""
    inputs = [
        (bag, settings)
        for bag in sorted({path.parent for path in folder.rglob('metadata.yaml')})
        for settings in (None, *_settings_beside(bag, folder))
    ]
    print(HEADER)

    def one(item: tuple[Path, Path | None]) -> Outcome:
        bag, settings = item
        name = str(bag.relative_to(folder))
        out = work / 'external' / name.replace('/', '_') / (settings.stem if settings else 'plain')
        words = [] if settings is None else ['--config', str(settings)]
        outcome = run_map(bag, out, words)
        (out.with_suffix('.txt')).parent.mkdir(parents=True, exist_ok=True)
        out.with_suffix('.txt').write_text(outcome.printed)
        said = bool(outcome.said)
        verdict = CRASH if outcome.crashed else 'said' if said else 'nothing said'
        print(row(name, settings.name if settings else '', outcome, None, verdict), flush=True)
        return outcome

    with ThreadPoolExecutor(jobs) as pool:
        outcomes = list(pool.map(one, inputs))
    return 1 if any(outcome.crashed for outcome in outcomes) else 0


def _settings_beside(bag: Path, folder: Path) -> list[Path]:
    """Settings files between a bag and the folder in which it was looked for."""
    owners = [path for path in bag.parents if path != folder and folder in path.parents]
    return sorted(path for owner in owners for path in owner.glob('*.yaml'))


def run_clean(inputs: Iterable[str], work: Path, jobs: int) -> int:
    """Map sound inputs and list their warnings; returns the exit status."""

    def one(item: str) -> bool:
        path, _, config = item.partition('@')
        out = work / 'clean' / item.strip('/').replace('/', '_')
        outcome = run_map(Path(path), out, ['--config', config] if config else [])
        lines = [f'{item}: status {outcome.status}, {outcome.seconds:.0f} s']
        if outcome.errors is not None:
            lines[0] += f', ATE {outcome.errors[0]:.3f} m'
        found = (outcome.stats or {}).get('warnings', [])
        lines += [
            f'    {item["severity"]} {item["rule"]} {item["sensor"]}: {item["text"]}; '
            f'{item["remedy"]}'
            for item in found
        ]
        if outcome.status != 0:
            lines += [f'    {line}' for line in outcome.printed.splitlines()[-3:]]
        print('\n'.join(lines), flush=True)
        return bool(found) or outcome.status != 0

    with ThreadPoolExecutor(jobs) as pool:
        warned = list(pool.map(one, inputs))
    print(f'\n{sum(warned)} of {len(warned)} inputs with warnings')
    return 1 if any(warned) else 0


def _fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def main() -> int:
    """Run the program; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument('names', nargs='*', metavar='NAME', help='generators; all without any')
    parser.add_argument('--timed', action='store_true', help='points have times in all drives')
    parser.add_argument('--list', action='store_true', help='name the generators and go')
    parser.add_argument('--external', type=Path, metavar='FOLDER', help='map inputs made elsewhere')
    parser.add_argument('--clean', nargs='+', metavar='INPUT[@CONFIG]', help='map sound inputs')
    parser.add_argument('--jobs', type=int, default=1, metavar='N', help='runs at a time')
    parser.add_argument('--out', type=Path, metavar='FOLDER', help='keep everything here')
    args = parser.parse_args()
    if args.list:
        for lie in LIES.values():
            print(f'{lie.name:<24} {lie.situation} ({", ".join(lie.expected)})')
        return 0
    work = args.out or Path(tempfile.mkdtemp(prefix='field_'))
    try:
        if args.external is not None:
            return run_external(args.external, work, args.jobs)
        if args.clean:
            return run_clean(args.clean, work, args.jobs)
        return run_lies(args.names, work, args.jobs, args.timed)
    finally:
        if args.out is None:
            shutil.rmtree(work, ignore_errors=True)


if __name__ == '__main__':
    os.environ.setdefault('PYTHONPATH', str(Path(__file__).resolve().parents[1]))
    sys.exit(main())
