"""Folders that appear when they are complete, and never over anything."""

import os
import shutil
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

from incremental_mapper.errors import OutputError


def write_folder(target: Path, write: Callable[[Path], object]) -> Path:
    """Write into a hidden folder that gets its name when all is on the disk.

    Args:
        target: The folder; where it exists, ``target_2`` and so on is made.
        write: Writes into the folder that it is given.

    Returns:
        The folder that was made.

    Raises:
        OutputError: It cannot be written; nothing is left of it.
    """
    scratch: Path | None = None
    try:
        scratch = hidden_folder(target)
        write(scratch)
        sync_folder(scratch)
        place = free_name(target)
        scratch.rename(place)
    except OSError as error:
        raise OutputError(f'{target}: cannot be written ({error.strerror or error})') from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(scratch), str(target))) from error
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)
    return place


def hidden_folder(target: Path) -> Path:
    """Make an empty hidden folder beside a path, to be given that name when it is complete.

    Args:
        target: The path; the folders above it are made.

    Raises:
        OSError: It cannot be made.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f'.{target.name}.', dir=target.parent))
    # mkdtemp makes folders that only their owner can read.
    scratch.chmod(0o755)
    return scratch


def sync_folder(folder: Path) -> None:
    """Wait until a folder's files are on the disk: a robot's power may be cut at any time.

    Args:
        folder: A folder without folders in it.

    Raises:
        OSError: The disk says that it cannot.
    """
    for path in (*folder.iterdir(), folder):
        number = os.open(path, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def free_name(target: Path) -> Path:
    """The path itself, or with the first number that makes it one that is not taken.

    Args:
        target: The path.
    """
    numbers = count(2)
    place = target
    while place.exists() or place.is_symlink():
        place = target.with_name(f'{target.name}_{next(numbers)}')
    return place
