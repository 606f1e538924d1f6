"""The folder of a run: the files that are in it, and writing them; ``finished_run`` reads them.

``trajectory.tum``, ``map.ply``, ``map_scans.ply``, ``graph.g2o``, ``graph.json`` (see
``graph_json``), ``windows.csv``, ``stats.json`` (see ``run_statistics``), ``session.bin`` (see
``session_file``) and ``files.json`` (see ``manifest``), by which one knows whether the others are
whole, are always there; pictures and
``candidates.parquet`` (see ``candidate_table``) where their libraries are installed, and
``failed_window_N.npz`` (see ``window_record``) where a window failed.
"""

import contextlib
import csv
import errno
import fcntl
import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import MapperError, OutputError
from incremental_mapper.exports.formats import export, formats, named
from incremental_mapper.finite import not_finite
from incremental_mapper.map.ply import SCANS, MapCloud, write_ply, write_scans
from incremental_mapper.mapping.result import MapResult
from incremental_mapper.results.candidate_table import FILE_NAME
from incremental_mapper.results.file_names import (
    DATA,
    EXTRA_FILES,
    FAILED_WINDOWS,
    FILES,
    GRAPH,
    GRAPH_G2O,
    MAP,
    STATISTICS,
    TRAJECTORY,
    WINDOWS,
    is_partial,
)
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.results.graph_json import graph_tree
from incremental_mapper.results.manifest import FILE as MANIFEST
from incremental_mapper.results.manifest import Manifest
from incremental_mapper.results.messages.output_bag import remove_bag
from incremental_mapper.results.sessions.session_file import FILE as SESSION
from incremental_mapper.results.sessions.session_file import write_session
from incremental_mapper.trajectory import Trajectory, write_tum
from incremental_mapper.variables import cluster_of, pose_key
from incremental_mapper.visualization.pictures import drawn_points
from incremental_mapper.visualization.run_pictures import Shown

LOGGER = logging.getLogger('incremental_mapper')


@contextmanager
def prepared_folder(folder: Path, force: bool) -> Iterator[None]:
    """Make an output folder, into which nobody else may write meanwhile.

    Of two runs that wrote into one folder, each file was that of the last one to write it, and the
    checksums said that all was whole.

    Args:
        folder: It may exist, and be empty.
        force: It may hold something. What an earlier run wrote is removed, so that no file of
            another drive lies beside those of this one; all else stays.

    Yields:
        Nothing; the folder is this run's until the block ends, or the process.

    Raises:
        OutputError: It holds something and ``force`` is not given, it cannot be made, or another
            run writes into it.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f'{folder}: is a file, expected a folder for the output')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claim = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise OutputError(f'{folder}: cannot be made ({error.strerror})') from error
    try:
        try:
            fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise OutputError(
                f'{folder}: another run is writing into it; name another folder'
            ) from error
        except OSError:
            pass  # a file system without locks
        _empty(folder, force)
        yield
    finally:
        os.close(claim)


def _empty(folder: Path, force: bool) -> None:
    try:
        left = [path for path in folder.iterdir() if is_partial(path.name)]
        if not force and len(left) < len(list(folder.iterdir())):
            raise OutputError(f'{folder}: is not empty; name another folder or add --force')
        for path in left:
            path.unlink()
        # Names that others use as well go only where a run has been.
        if (folder / STATISTICS).is_file() and (folder / GRAPH).is_file():
            exported = [form.file_name for form in formats().values()]
            for name in dict.fromkeys((*FILES, *EXTRA_FILES, *exported)):
                (folder / name).unlink(missing_ok=True)
            remove_bag(folder)
            for path in folder.glob(FAILED_WINDOWS):
                path.unlink()
    except OSError as error:
        raise OutputError(f'{folder}: cannot be made ({error.strerror})') from error


def write_result(
    folder: Path, result: MapResult, cloud: MapCloud, stats: Mapping[str, Any]
) -> None:
    """Write all data files of a run; pictures are not among them.

    Every file is written beside its name first and then renamed, so that an interrupted run
    leaves no torn file. Trajectory and graph come first; the points, which are most of the
    bytes, come after them, then the checksums of all these (``is_whole``), and the formats of
    ``map.formats`` last.

    Args:
        folder: An existing folder.
        result: What the mapper made.
        cloud: The map.
        stats: The keys of ``stats.json``, see ``RunStatistics.to_tree``.

    Raises:
        OutputError: A file cannot be written.
    """
    poses = result.trajectory
    _refuse(folder / TRAJECTORY, positions=poses.positions, quaternions=poses.quaternions)
    _write(folder / TRAJECTORY, lambda path: write_tum(path, poses))
    graph = graph_tree(result.clusters, result.factors, result.values)
    _write_json(folder / GRAPH, graph)
    _write(folder / GRAPH_G2O, lambda path: _write_g2o(path, result))
    _write(folder / WINDOWS, lambda path: _write_rows(path, result.rows))
    for record in result.failed:
        _write(folder / record.name, partial(Path.write_bytes, data=record.data))
    _write_json(folder / STATISTICS, stats, indent=2)
    _write_session(folder, result)
    _refuse(folder / MAP, points=cloud.points)
    _write(folder / SCANS, lambda path: write_scans(path, cloud))
    _write(folder / MAP, lambda path: write_ply(path, cloud))
    names = [*DATA, *(record.name for record in result.failed)]
    names += [FILE_NAME] if (folder / FILE_NAME).is_file() else []
    names = [name for name in names if name != SESSION or (folder / name).is_file()]
    _write(folder / MANIFEST, lambda path: _write_manifest(path, folder, names))
    _write_formats(folder, stats)


def is_whole(folder: Path) -> bool:
    """Whether all data files of a run are written, whatever came of the formats besides.

    Args:
        folder: The folder that ``write_result`` was given.
    """
    return (folder / MANIFEST).is_file()


def shown_of(result: MapResult, cloud: MapCloud, truth: Trajectory | None) -> Shown:
    """What the pictures of a run show.

    Arguments are as in ``write_result``; ``truth`` is the true trajectory, where there is one.
    """
    return Shown(
        result.trajectory,
        truth,
        result.fixes,
        drawn_points(cloud.points[:, :3]),
        len(cloud),
        graph_tree(result.clusters, result.factors, result.values),
        result.statistics.georeferenced,
    )


def _write_session(folder: Path, result: MapResult) -> None:
    """Write what another session can go on from, if GTSAM can write all of its factors."""
    try:
        _write(folder / SESSION, lambda path: write_session(path, result))
    except (RuntimeError, TypeError) as error:
        (folder / f'.{SESSION}.partial').unlink(missing_ok=True)
        reason = ' '.join(str(error).split())[:200]
        LOGGER.warning('no %s, no session can go on from %s: %s', SESSION, folder, reason)


def _write_formats(folder: Path, stats: Mapping[str, Any]) -> None:
    """Write what the settings want besides; what fails is told once the others are written."""
    wanted = stats.get('settings', {}).get('map', {}).get('formats', ())
    troubles = []
    for name in wanted:
        try:
            form = named(name, 'map.formats')
            if form.file_name not in FILES:
                export(FinishedRun(folder), form, folder / form.file_name)
        except MapperError as error:
            troubles.append(str(error))
    if troubles:
        raise OutputError('; '.join(troubles))


def _write_g2o(path: Path, result: MapResult) -> None:
    # GTSAM writes poses and relative poses only; g2o has no tags for the rest. Plain cluster
    # numbers replace the symbols, which other readers would show as 19-digit numbers.
    graph, poses = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for placed in result.clusters:
        poses.insert(placed.id, result.values.atPose3(pose_key(placed.id)))
    for factor in result.factors:
        if isinstance(factor.factor, gtsam.BetweenFactorPose3):
            first, second = (cluster_of(key) for key in factor.keys)
            noise = factor.factor.noiseModel()
            if isinstance(noise, gtsam.noiseModel.Robust):  # g2o knows none, and GTSAM raises
                noise = noise.noise()
            graph.push_back(
                gtsam.BetweenFactorPose3(first, second, factor.factor.measured(), noise)
            )
    gtsam.writeG2o(graph, poses, str(path))
    # GTSAM says nothing where the disk is full: a line for each pose and factor must be there.
    with path.open('rb') as file:
        lines = sum(block.count(b'\n') for block in iter(partial(file.read, 1 << 20), b''))
    if lines != poses.size() + graph.size():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _write_manifest(path: Path, folder: Path, names: Sequence[str]) -> None:
    path.write_text(Manifest.of(folder, names).to_text(), encoding='utf-8')


def _write_json(path: Path, tree: Mapping[str, Any], indent: int | None = None) -> None:
    try:
        # Not json.dump, which has no compiled writer: of a long drive it takes seconds.
        text = json.dumps(tree, indent=indent, allow_nan=False) + '\n'
    except ValueError as error:
        # It does not say which one.
        raise OutputError(f'{path}: not written: a number is not finite') from error
    _write(path, partial(Path.write_text, data=text, encoding='utf-8'))


def _write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]) if rows else ['window'])
        writer.writeheader()
        writer.writerows(rows)


def _refuse(path: Path, **numbers: NDArray[np.floating]) -> None:
    """Raise OutputError where a file would hold numbers that are not finite."""
    wrong = not_finite(numbers)
    if wrong:
        raise OutputError(f'{path}: not written: {wrong} are not finite')


def _write(path: Path, write: Callable[[Path], object]) -> None:
    beside = path.with_name(f'.{path.name}.partial')
    try:
        write(beside)
        beside.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            beside.unlink()  # of no use, and it may take the room of what comes next
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error
