"""The true trajectory of a drive: a TUM file, or KAIST's ``global_pose.csv``."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from incremental_mapper.datasets.kaist_files import read_table
from incremental_mapper.errors import InputError
from incremental_mapper.measurements import Drops
from incremental_mapper.trajectory import Trajectory, from_matrices, read_tum

TRUTH_FILES = ('ground_truth.tum', 'global_pose.csv')


def read_truth(path: Path) -> Trajectory:
    """Read a true trajectory.

    Args:
        path: TUM text, or KAIST's ``global_pose.csv``; commas tell them apart.

    Returns:
        T_world_base at the file's stamps.

    Raises:
        InputError: the file is missing or holds no pose.
    """
    if not path.is_file():
        raise InputError(f'{path}: is no file; expected a TUM trajectory or a global_pose.csv')
    try:
        with path.open(encoding='utf-8', errors='replace') as file:
            first = next((line for line in file if line.strip() and line[0] != '#'), '')
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    return read_global_pose(path) if ',' in first else read_tum(path)


def read_global_pose(path: Path) -> Trajectory:
    """Read KAIST's ``global_pose.csv``.

    Args:
        path: lines of a stamp in nanoseconds and a row-major 3x4 matrix T_world_base; lines that
            are no pose are skipped.

    Returns:
        The poses, sorted by stamp.

    Raises:
        InputError: the file cannot be read or holds no pose.
    """
    unreadable: Drops = Counter()
    table = read_table(path, 12, 'truth', unreadable)
    poses = table.values.reshape(-1, 3, 4)
    rotations = poses[:, :, :3]
    errors = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    # A NaN compares false, so lines that are not finite go as well.
    good = (
        (errors < 1e-2) & (np.linalg.det(rotations) > 0) & np.isfinite(poses[:, :, 3]).all(axis=1)
    )
    if not good.any():
        raise InputError(
            f'{path}: holds no pose; expected lines "stamp, 12 numbers of a row-major 3x4 matrix"'
        )
    return from_matrices(table.stamps[good], poses[good])


def find_truth(folders: list[Path]) -> Trajectory | None:
    """Read the first trajectory file in some folders, or return None where there is none.

    Raises:
        InputError: it holds no pose.
    """
    path = truth_file(folders)
    return None if path is None else read_truth(path)


def truth_file(folders: Iterable[Path]) -> Path | None:
    """Find the first trajectory file in some folders."""
    files = (folder / name for folder in folders for name in TRUTH_FILES)
    return next((path for path in files if path.is_file()), None)
