"""The graph as g2o, and in full as JSON, whose layout ``graph.schema.json`` beside this tells."""

import shutil
from collections.abc import Sequence
from pathlib import Path

from incremental_mapper.errors import InputError
from incremental_mapper.exports.exported_run import ExportedRun

SCHEMA = 'graph.schema.json'


def write_g2o(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """Poses and relative poses, for tools that read g2o."""
    _copy(run, 'graph.g2o', path)
    return ('g2o holds poses and relative poses only; json has the rest',)


def write_json(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """All of the graph."""
    _ = run.graph  # is one
    _copy(run, 'graph.json', path)
    return ()


def _copy(run: ExportedRun, name: str, path: Path) -> None:
    source = run.folder / name
    if not source.is_file():
        raise InputError(f'{run.folder}: {name} is missing')
    shutil.copyfile(source, path)
