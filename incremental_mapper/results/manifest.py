"""``files.json``: the format of a run's folder, and the checksum of every data file in it.

It is written last: a folder without it is older than it, or not complete.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from incremental_mapper import __version__
from incremental_mapper.errors import InputError

FILE = 'files.json'
FORMAT = 1
"""Counts up where a reader of older folders would not understand a newer one."""


@dataclass(frozen=True, slots=True)
class Manifest:
    """What ``files.json`` says: format, version of the package, SHA-256 by name of the file."""

    format: int
    package: str
    files: Mapping[str, str]

    @classmethod
    def of(cls, folder: Path, names: Iterable[str]) -> 'Manifest':
        """That of a folder as it is.

        Args:
            folder: The folder.
            names: Files in it.

        Raises:
            OSError: One cannot be read.
        """
        return cls(FORMAT, __version__, {name: _sum(folder / name) for name in sorted(names)})

    @classmethod
    def read(cls, folder: Path) -> 'Manifest | None':
        """That of a folder as it was written; None where there is none.

        Args:
            folder: The folder.

        Raises:
            InputError: It is damaged.
        """
        path = folder / FILE
        try:
            tree = json.loads(path.read_text(encoding='utf-8'))
            files = {str(name): str(sum_) for name, sum_ in tree['files'].items()}
            return cls(int(tree['format']), str(tree['package']), files)
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f'{path}: is damaged, or no list of the files of a run') from error

    def to_text(self) -> str:
        """The content of ``files.json``."""
        tree = {'format': self.format, 'package': self.package, 'files': dict(self.files)}
        return json.dumps(tree, indent=2) + '\n'

    def sound(self, folder: Path, name: str) -> bool:
        """Whether a file is as it was written; those that are not listed are.

        Args:
            folder: The folder.
            name: Name of the file.
        """
        wanted = self.files.get(name)
        try:
            return wanted is None or wanted == _sum(folder / name)
        except OSError:
            return False


def require_whole(folder: Path) -> Manifest:
    """Refuse a folder that nobody should build upon: damaged, incomplete, or of another format.

    Args:
        folder: The folder of a run.

    Returns:
        What its ``files.json`` says.

    Raises:
        InputError: It is not whole.
    """
    manifest = Manifest.read(folder)
    if manifest is None:
        raise InputError(
            f'{folder}: has no {FILE}: it is not complete, or an older version wrote it; '
            'map the drive again'
        )
    if manifest.format != FORMAT:
        raise InputError(
            f'{folder}: has format {manifest.format} of version {manifest.package}, this version '
            f'reads {FORMAT}; use that version, or map the drive again'
        )
    wrong = [name for name in manifest.files if not manifest.sound(folder, name)]
    if wrong:
        raise InputError(
            f'{folder}: {" and ".join(wrong)} cannot be trusted: damaged or changed since it was '
            'written; map the drive again'
        )
    return manifest


def _sum(path: Path) -> str:
    with path.open('rb') as file:
        return hashlib.file_digest(file, 'sha256').hexdigest()
