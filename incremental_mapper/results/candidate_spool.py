"""What windows chose from, set aside while a node drives, for ``candidates.parquet`` when it saves.

A row of the table costs as much as keeping its candidate, and a hundred times as much again to be
made into a group of Parquet; so candidates are kept as they are, compressed, in a file without a
name. An hour of two LiDARs at 10 Hz takes some 50 MB of it, and no memory.
"""

import os
import pickle
import tempfile
import zlib
from array import array
from collections.abc import Iterator
from pathlib import Path

from incremental_mapper.mapping.result import WindowResult

FAST = 1
"""Level of compression: a fifth of the size in a tenth of the time that pickling takes."""


class CandidateSpool:
    """Keeps what the table of candidates needs of every window.

    Any process that was forked from this one may read what was added until then. A disk that is
    full ends the keeping, not the map: ``trouble`` then says why.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """Begin; ``folder`` is where the file lies, by default the system's for temporary files."""
        self._sizes = array('Q')
        self._end = 0
        self.trouble = ''
        try:
            self._file = tempfile.TemporaryFile(  # noqa: SIM115 (lives as long as the map)
                prefix='incremental_mapper_', dir=folder, buffering=0
            )
        except OSError as error:
            self._give_up(error)

    def add(self, window: WindowResult) -> None:
        """Keep a window's candidates."""
        if self.trouble or not (window.tried or window.winner):
            return
        kept = WindowResult(
            window.index,
            window.start,
            window.end,
            window.winner,
            (),
            (),
            {'score_name': window.row['score_name']},
            tried=window.tried,
        )
        data = zlib.compress(pickle.dumps(kept, pickle.HIGHEST_PROTOCOL), FAST)
        written = 0
        try:
            while written < len(data):
                written += os.pwrite(self._file.fileno(), data[written:], self._end + written)
        except OSError as error:
            self._give_up(error)
            return
        self._sizes.append(len(data))
        self._end += len(data)

    def windows(self) -> Iterator[WindowResult]:
        """The windows so far, as far as ``candidate_rows`` looks at them.

        Raises:
            OSError: They cannot be read back.
        """
        offset = 0
        for size in self._sizes:
            data = os.pread(self._file.fileno(), size, offset)
            offset += size
            window: WindowResult = pickle.loads(zlib.decompress(data))
            yield window

    def close(self) -> None:
        """Let go of the file."""
        if not self.trouble:
            self._file.close()

    def _give_up(self, error: OSError) -> None:
        self.trouble = error.strerror or str(error)
