"""Numbers in memory that a fork of this process shares, where it would else copy them.

After a fork each page of memory is copied when it is first written to, and whoever writes waits.
What grows with every window and no fork ever looks at, such as the voxels that a node shows, had
that cost the first windows beside a search for loops 30 to 50 ms each.
"""

import mmap
import os

import numpy as np
from numpy.typing import NDArray

SHARED = hasattr(os, 'memfd_create')
"""Whether the system has memory of that kind; elsewhere it is that of every array."""
BYTES = 4


class SharedRows:
    """Rows of 32-bit integers, of which there may be more with time."""

    def __init__(self, columns: int) -> None:
        """Have none yet.

        Args:
            columns: Of each row.
        """
        self._columns, self._count = columns, 0
        self._memory: mmap.mmap | None = None

    def rows(self) -> NDArray[np.int32]:
        """All rows (N, columns); to be let go of before there are more."""
        if self._memory is None:
            return np.empty((0, self._columns), dtype=np.int32)
        numbers = np.frombuffer(self._memory, dtype=np.int32, count=self._count * self._columns)
        return numbers.reshape(self._count, self._columns)

    def grow(self, count: int) -> bool:
        """Add rows of zeros behind those that there are.

        Args:
            count: How many there are then; not fewer than before.

        Returns:
            Whether it could be done: a limit on the size of files holds for such memory, too.
        """
        try:
            self._memory = self._resized(BYTES * max(count * self._columns, 1))
        except OSError:
            return False
        self._count = count
        return True

    def _resized(self, size: int) -> mmap.mmap:
        memory = self._memory
        if memory is None:
            file = os.memfd_create('rows')
            try:
                os.ftruncate(file, size)
                return mmap.mmap(file, size)
            finally:
                os.close(file)
        memory.resize(size)  # the pages stay where they are
        return memory


def shared_zeros(count: int) -> NDArray[np.int32]:
    """Zeros (N,) in memory that a fork shares, where the system has such.

    Args:
        count: How many.
    """
    try:
        return np.frombuffer(mmap.mmap(-1, BYTES * count), dtype=np.int32)
    except OSError:
        return np.zeros(count, dtype=np.int32)
