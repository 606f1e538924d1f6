"""The walk of one scan through the rooms: which files it passes between message and saved graph.

    python benchmarks/scan_walk.py BAG [--window N] [--steps]

Maps the bag until window N is about to close, then follows everything that runs while the next
message of a LiDAR is read, its window is closed, and the map is saved. A step is a function's
first call, in the order of first calls; a room is a folder directly below the package, and the
modules beside the folders (measurements, geometry, settings) are the ground on which all stand.
Prints the number of files and how often one step lies in another room than the one before.
Works on any state of the code that has the command line (PYTHONPATH=OTHER_CHECKOUT).
"""

import argparse
import importlib
import sys
import tempfile
from itertools import groupby
from pathlib import Path
from types import CodeType, FrameType, ModuleType
from typing import Any

import incremental_mapper

ROOT = Path(incremental_mapper.__file__).parent
CONFIG = ROOT.parent / 'config' / 'kaist.yaml'


def find(*names: str) -> Any:
    """The first ``module:attribute`` that this state of the code has."""
    for name in names:
        module, _, attribute = name.partition(':')
        try:
            found: ModuleType = importlib.import_module(f'incremental_mapper.{module}')
            return getattr(found, attribute)
        except (ModuleNotFoundError, AttributeError):
            continue
    raise SystemExit(f'none of {", ".join(names)} is there')


class Walk:
    """Notes every function of the package when it is called for the first time."""

    def __init__(self) -> None:
        self.steps: list[tuple[str, str]] = []
        self._seen: set[CodeType] = set()

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        """What sys.setprofile calls."""
        code = frame.f_code
        if event != 'call' or code in self._seen:
            return
        self._seen.add(code)
        path = Path(code.co_filename)
        # Bodies of classes and modules run on import, which is no step of the scan.
        if path.is_relative_to(ROOT) and code.co_name != '<module>':
            self.steps.append((str(path.relative_to(ROOT)), code.co_qualname))


def room(file: str) -> str | None:
    """The folder below the package, None for the ground floor."""
    return file.split('/')[0] if '/' in file else None


def follow(bag: Path, window: int, out: Path) -> Walk:
    """Map ``bag`` up to a window, then trace one scan from its message to the saved files."""
    open_source = find('datasets.open:open_source')
    read_yaml = find('config:read_yaml')
    make_config, merge = find('config:make_config'), find('config:merge')
    mapper_class = find('mapping.mapper:Mapper', 'mapper.mapper:Mapper')
    write = find('results.run_folder:write_result', 'mapper.output:write_result')
    points_of = find('results.offline_run:map_points', 'evaluation.run:map_points')
    # In one process, so that the whole walk is seen.
    single = {'odometry': {'processes': False}}
    tree = merge(read_yaml(CONFIG), single)
    source = open_source(bag, tree)
    config = make_config(merge(source.info.settings, tree), 'settings')
    mapper = mapper_class(config, list(source.info.counts))
    measurements = source.measurements()
    # Each path is walked once before, so that no kernel is compiled while it is followed.
    closed = 0
    for measurement in measurements:
        closed += len(mapper.push(measurement))
        if closed >= window:
            break
    result = mapper.result()
    write(out, result, points_of(result, config), {})
    walk = Walk()
    sys.setprofile(walk)
    try:
        for measurement in measurements:
            if mapper.push(measurement):
                break
        result = mapper.result()
        write(out, result, points_of(result, config), {})
    finally:
        sys.setprofile(None)
    mapper.close()
    return walk


def main() -> int:
    """Print the walk and its two numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bag', type=Path)
    parser.add_argument('--window', type=int, default=40)
    parser.add_argument('--steps', action='store_true', help='list every step')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        walk = follow(args.bag, args.window, Path(folder))
    inside = [(room(file), file, name) for file, name in walk.steps if room(file)]
    visits = [(name, list(steps)) for name, steps in groupby(inside, key=lambda step: step[0])]
    for name, steps in visits:
        files = dict.fromkeys(file.split('/', 1)[1] for _, file, _ in steps)
        print(f'{name:<12} {", ".join(files)}')
        if args.steps:
            print('\n'.join(f'    {file}: {function}' for _, file, function in steps))
    files_passed = len({file for file, _ in walk.steps})
    rooms = len({name for name, _ in visits})
    print(f'{files_passed} files, {len(visits) - 1} changes of room, {rooms} rooms')
    return 0


if __name__ == '__main__':
    sys.exit(main())
