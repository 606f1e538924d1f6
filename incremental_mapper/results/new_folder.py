"""Folders that appear when they are complete, and never over anything."""

import contextlib
import errno
import fcntl
import glob
import os
import shutil
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path

from incremental_mapper.errors import ConfigError, OutputError
from incremental_mapper.results.file_names import is_of_run

RANDOM = 8
"""Characters that tempfile adds to a name."""


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
    scratch: HiddenFolder | None = None
    try:
        scratch = HiddenFolder(target)
        scratch.fill(write)
        return scratch.appear(target)
    except OSError as error:
        raise OutputError(f'{target}: cannot be written ({error.strerror or error})') from error
    finally:
        if scratch is not None:
            scratch.drop()


class HiddenFolder:
    """An empty hidden folder beside a path, to be given that name when it is complete.

    It is locked as long as somebody writes into it: what a program leaves that was killed, or
    whose power went, is as large as a map, hidden, and would stay for ever. The next one for the
    same path removes it.
    """

    def __init__(self, target: Path) -> None:
        """Make it.

        Args:
            target: The path; the folders above it are made.

        Raises:
            OSError: It cannot be made.
        """
        self._target = target
        target.parent.mkdir(parents=True, exist_ok=True)
        prefix = f'.{target.name}.'
        for left in target.parent.glob(f'{glob.escape(prefix)}{"[a-z0-9_]" * RANDOM}'):
            _remove_left(left)
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
        self._claim = os.open(self.path, os.O_RDONLY)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(self._claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # mkdtemp makes folders that only their owner can read.
        self.path.chmod(0o755)

    def fill(self, write: Callable[[Path], object]) -> None:
        """Have it written, and brought to the disk.

        Args:
            write: Is called with it.

        Raises:
            OSError: It cannot be written.
            OutputError: As ``write`` raised it, with the path that users know.
        """
        try:
            write(self.path)
        except OutputError as error:
            raise OutputError(str(error).replace(str(self.path), str(self._target))) from error
        sync_folder(self.path)

    def appear(self, target: Path) -> Path:
        """Give it a name, or one with a number where that is taken.

        Args:
            target: The path.

        Returns:
            Where it is now.

        Raises:
            OSError: It cannot be moved.
        """
        while True:
            place = free_name(target)
            try:
                self.path.rename(place)
            except OSError as error:
                # Somebody else took the name meanwhile.
                if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):
                    raise
            else:
                return place

    def drop(self) -> None:
        """Remove it, unless it has its name."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._claim)


def _remove_left(folder: Path) -> None:
    """Remove a hidden folder that nobody writes into any more, if all in it is ours."""
    try:
        claim = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if all(is_of_run(path.name) for path in folder.iterdir()):
            shutil.rmtree(folder, ignore_errors=True)
    except (OSError, ConfigError):
        return  # it is being written, or nobody can tell
    finally:
        os.close(claim)


def obstacle(target: Path) -> str:
    """Why a folder could not be made now; empty where nothing is known to be in the way.

    Args:
        target: The folder.
    """
    above = target.expanduser().absolute().parent
    while not above.exists() and above != above.parent:
        above = above.parent
    if not above.is_dir():
        return f'{above} is no folder'
    return '' if os.access(above, os.W_OK | os.X_OK) else f'{above} cannot be written'


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
