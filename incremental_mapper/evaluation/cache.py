"""Which runs of an evaluation are done already.

A run is known by a key over everything that its numbers depend on. The key is written into the
run's folder after all other files, so a run that was cut short never counts as finished.

An input is recognised by the names, sizes and modification times of its files, not by their
contents: a drive of 20 GB is looked through in a second, and tools that change a file without
touching either do not occur in practice. ``--force`` runs everything again.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import incremental_mapper
from incremental_mapper.datasets.truth import TRUTH_FILES
from incremental_mapper.results.file_names import FILES
from incremental_mapper.results.run_statistics import versions
from incremental_mapper.selection.strategies import BUILT_IN, GROUP

MARK = 'finished.json'
TRUTH_FILE = 'truth.tum'
"""True poses of a sequence, beside the folders of its runs."""
IDLE_ROOMS = ('cli', 'ros', 'evaluation', 'visualization')
"""Rooms of the package that no number of a run depends on; pictures may be of an older look."""


def digest(tree: Any) -> str:
    """A short fingerprint of plain values."""
    text = json.dumps(tree, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def input_fingerprint(path: Path) -> str:
    """Fingerprint of an input: names, sizes and modification times of all its files.

    Truth that may lie beside the input belongs to it. An input that is missing or cannot be
    listed has the fingerprint of nothing; opening it tells what is wrong.
    """
    return digest(sorted(_facts(path)))


def file_fingerprint(path: Path | None) -> str:
    """The same for one file, or for none."""
    return digest([] if path is None or not path.is_file() else [_fact(path, path.parent)])


def code_fingerprint(root: Path, files: Sequence[Path]) -> str:
    """Fingerprint of the names below ``root`` and the contents of source files."""
    names = [path.relative_to(root).as_posix() for path in files]
    contents = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    return digest(list(zip(names, contents, strict=True)))[:16]


def program(strategy: str) -> dict[str, str]:
    """What computes the numbers of a strategy: versions, the package's code, and its own.

    Code counts by its contents, so that a checkout whose version stays the same does not pass off
    old numbers as new ones.

    Args:
        strategy: A name; that of an entry point adds the code of the package that brings it.
    """
    found = dict(own_program())
    if strategy not in BUILT_IN:
        for entry in entry_points(group=GROUP, name=strategy):
            version = '' if entry.dist is None else entry.dist.version
            found[f'strategy {strategy}'] = f'{version} {_package_fingerprint(entry.module)}'
    return found


@cache
def own_program() -> Mapping[str, str]:
    """Versions of this package and of the libraries below it, and a fingerprint of its code."""
    root = Path(incremental_mapper.__file__).parent
    files = [
        path
        for path in sorted(root.rglob('*.py'))
        if path.relative_to(root).parts[0] not in IDLE_ROOMS
    ]
    return versions() | {'code': code_fingerprint(root, files)}


def _package_fingerprint(module: str) -> str:
    """That of the top-level package which a module is in."""
    spec = find_spec(module.partition('.')[0])
    if spec is None or spec.origin is None:
        return ''
    place = Path(spec.origin)
    root = place.parent
    files = sorted(root.rglob('*.py')) if spec.submodule_search_locations else [place]
    return code_fingerprint(root, files)


def is_finished(folder: Path, key: str) -> bool:
    """Whether a folder holds the whole run that ``key`` stands for."""
    try:
        mark = json.loads((folder / MARK).read_text(encoding='utf-8'))
        paths = [folder / name for name in (*FILES, *mark['files'])]
        if mark['truth']:
            paths.append(folder.parent / TRUTH_FILE)
        return bool(mark['key'] == key) and all(path.is_file() for path in paths)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def mark_finished(folder: Path, key: str, truth: bool, made_of: Mapping[str, Any]) -> None:
    """Declare a run finished; ``truth`` tells whether the true trajectory lies beside it.

    ``made_of`` tells a reader what the key was computed from.
    """
    files = sorted(path.name for path in folder.iterdir() if path.name != MARK)
    write_json(folder / MARK, {'key': key, 'files': files, 'truth': truth, **made_of})


def clear(folder: Path) -> None:
    """Remove what an earlier run left in a folder, its mark first, and nothing else."""
    mark = folder / MARK
    try:
        names = json.loads(mark.read_text(encoding='utf-8'))['files']
    except (OSError, ValueError, KeyError, TypeError):
        names = []
    mark.unlink(missing_ok=True)
    for name in [*FILES, *names]:
        # A name with a slash is none that this module wrote.
        if Path(name).name == name:
            (folder / name).unlink(missing_ok=True)


def write_json(path: Path, tree: Any) -> None:
    """Write plain values so that a reader sees the old file or the new one, never a part."""
    partial = path.with_name(f'.{path.name}.partial')
    text = json.dumps(tree, indent=2, allow_nan=False, default=str)
    partial.write_text(text + '\n', encoding='utf-8')
    partial.replace(path)


def _facts(path: Path) -> Iterator[tuple[str, int, int]]:
    inside = sorted(path.rglob('*')) if path.is_dir() else [path]
    beside = [path.parent / name for name in TRUTH_FILES]
    for file in [*inside, *beside]:
        if file.is_file():
            yield _fact(file, path.parent)


def _fact(file: Path, root: Path) -> tuple[str, int, int]:
    status = file.stat()
    return (file.relative_to(root).as_posix(), status.st_size, status.st_mtime_ns)
