"""Journals that a node before this one left behind: their maps are made beside the mapping."""

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from incremental_mapper.config import Config
from incremental_mapper.results.file_names import JOURNAL
from incremental_mapper.ros.map_session import journal_folder
from incremental_mapper.ros.updates import Trouble, Update
from incremental_mapper.ros.urgency import make_way

NICE = 10
"""By how much a recovery is less urgent than the windows."""


class LeftOver:
    """The journals that there were when this was made, before the node began one of its own."""

    def __init__(self, config: Config, emit: Callable[[Update], None]) -> None:
        """Look for them.

        Args:
            config: All settings.
            emit: Takes what is told; called by any thread.
        """
        folder = journal_folder(config) if config.journal.recover else None
        self._emit, self._pictures = emit, config.save.pictures
        self.journals: Sequence[Path] = ()
        if folder is not None:
            with contextlib.suppress(OSError):
                self.journals = sorted(folder.glob(f'*{JOURNAL}'))

    def start(self) -> None:
        """Make their maps, one after the other, each in a process that goes on by itself."""
        if self.journals:
            threading.Thread(target=self._recover, name='recover', daemon=True).start()

    def _recover(self) -> None:
        for path in self.journals:
            self._emit(Trouble(f'a map was not saved: recovering {path}'))
            try:
                process = subprocess.Popen(
                    recover_command(path, self._pictures),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    text=True,
                    start_new_session=True,
                )
                make_way(NICE, process.pid)
                said, trouble = process.communicate()
            except OSError as error:
                self._emit(Trouble(f'{path}: not recovered: {error}'))
                return
            lines = [*said.splitlines()[-1:], *trouble.splitlines()]
            self._emit(Trouble('; '.join(['recovered to', *lines]) if said else '; '.join(lines)))


def recover_command(path: Path, pictures: bool) -> list[str]:
    """The program that makes the map of a journal, and removes it then.

    Args:
        path: The journal.
        pictures: Whether it draws pictures.
    """
    program = [sys.executable, '-m', 'incremental_mapper.cli.main', 'recover', str(path)]
    return [*program, '--remove', *([] if pictures else ['--no-pictures'])]
