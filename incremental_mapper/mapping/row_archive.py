"""The rows of ``windows.csv`` while a map is made: an hour of them as dictionaries takes 40 MB.

A vehicle that stands overnight adds a row a window and next to nothing else, so rows are packed.
"""

import pickle
import zlib
from typing import Any

Row = dict[str, Any]
BLOCK = 256
"""Rows that are packed together; so many, and fewer than that, are as they are."""
FAST = 1


class RowArchive:
    """Takes rows one by one and gives all of them back."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._newest: list[Row] = []

    def __len__(self) -> int:
        return BLOCK * len(self._blocks) + len(self._newest)

    def add(self, row: Row) -> None:
        """Keep a row; it must not change afterwards."""
        self._newest.append(row)
        if len(self._newest) == BLOCK:
            data = pickle.dumps(self._newest, pickle.HIGHEST_PROTOCOL)
            self._blocks.append(zlib.compress(data, FAST))
            self._newest = []

    def all(self) -> tuple[Row, ...]:
        """All rows, in their order."""
        packed = [row for block in self._blocks for row in pickle.loads(zlib.decompress(block))]
        return (*packed, *self._newest)
