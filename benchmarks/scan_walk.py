"""The walk of one scan through the rooms: which files it passes between message and saved graph.

    python benchmarks/scan_walk.py BAG [--window N] [--steps]

Maps the bag until window N is closed, then follows everything that runs while the next message
of a LiDAR is read, its window is closed, and the map is saved. A step is the first call of a named
function; a room is a folder directly below the package, and the modules beside the folders
(measurements, geometry, settings and so on) are the ground on which all stand. Prints the files in
the order of their first steps, and how often the room changes from one file to the next and from
one function to the next. Works on any state of the code (PYTHONPATH=OTHER_CHECKOUT).
"""

import argparse
import importlib
import sys
import tempfile
from collections.abc import Iterable
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
        # What has no name, such as a comprehension, is no step.
        if path.is_relative_to(ROOT) and not code.co_name.startswith('<'):
            self.steps.append((str(path.relative_to(ROOT)), code.co_qualname))


def room(file: str) -> str | None:
    """The folder below the package, None for the ground floor."""
    return file.split('/')[0] if '/' in file else None


def points_of(result: Any, config: Any) -> Any:
    """The map's points, by whichever way this state of the code has."""
    for name in ('cloud', 'points'):
        if hasattr(result, name):
            return getattr(result, name)(config.map)
    return find('evaluation.run:map_points')(result, config)


def follow(bag: Path, window: int, out: Path) -> Walk:
    """Map ``bag`` up to a window, then trace one scan from its message to the saved files."""
    open_source = find('datasets.open:open_source')
    read_yaml = find('settings:read_yaml', 'config:read_yaml')
    make_config = find('settings:make_config', 'config:make_config')
    merge = find('settings:merge', 'config:merge')
    mapper_class = find('mapper.mapper:Mapper', 'mapping.mapper:Mapper')
    write = find('mapper.output:write_result', 'results.run_folder:write_result')
    # In one process, so that the whole walk is seen.
    tree = merge(read_yaml(CONFIG), {'odometry': {'processes': False}})
    source = open_source(bag, tree)
    config = make_config(merge(source.info.settings, tree), 'settings')
    mapper = mapper_class(config, list(source.info.counts))
    measurements = iter(source.measurements())
    closed = 0
    while closed < window:
        closed += len(mapper.push(next(measurements)))
    # All is done once before, so that no kernel is compiled while it is followed.
    result = mapper.result()
    write(out, result, points_of(result, config), {})
    walk = Walk()
    try:
        windows, met_scan = [], False
        while not (met_scan and windows):
            if not met_scan:
                walk = Walk()  # the walk begins with the message of a scan
            sys.setprofile(walk)
            measurement = next(measurements)
            met_scan = met_scan or hasattr(measurement, 'points')
            if not met_scan:
                sys.setprofile(None)
            windows = mapper.push(measurement)
        result = mapper.result()
        write(out, result, points_of(result, config), {})
    finally:
        sys.setprofile(None)
    mapper.close()
    return walk


def changes(rooms: Iterable[str | None]) -> int:
    """How often one of the rooms differs from the one before."""
    return sum(1 for _ in groupby(rooms)) - 1


def main() -> int:
    """Print the walk and its two numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('bag', type=Path)
    parser.add_argument('--window', type=int, default=60)
    parser.add_argument('--steps', action='store_true', help='list every step')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        walk = follow(args.bag, args.window, Path(folder))
    inside = [(room(file), file, name) for file, name in walk.steps if room(file)]
    if args.steps:
        for name, steps in groupby(inside, key=lambda step: step[0]):
            print(name)
            print('\n'.join(f'    {file}: {function}' for _, file, function in steps))
    files = dict.fromkeys(file for _, file, _ in inside)
    for name, some in groupby(files, key=room):
        print(f'{name or "":<14} {", ".join(file.split("/", 1)[1] for file in some)}')
    print(
        f'{len(files)} files in {len(set(map(room, files)))} rooms; changes of room: '
        f'{changes(map(room, files))} from file to file, '
        f'{changes(name for name, _, _ in inside)} from function to function'
    )
    return 0


if __name__ == '__main__':
    sys.exit(main())
