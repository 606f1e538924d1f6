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
    """Rows of 32-bit integers, of which there may be more with time.

    To the system they are a file. Where it lets no file become that large (``ulimit -f``) they go
    on in memory that is not shared, which costs time and nothing else.
    """

    def __init__(self, columns: int) -> None:
        """Have none yet.

        Args:
            columns: Of each row.
        """
        self._columns, self._count = columns, 0
        self._memory: mmap.mmap | None = None
        self._count = 0
        self._own: NDArray[np.int32] | None = None

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
<<<<<<< HEAD
        before, self._count = self._count, count
        if self._own is None:
            try:
                self._memory = self._resized(BYTES * max(count * self._columns, 1))
                return self._of(self._memory, count)
            except OSError:
                held = None if self._memory is None else self._of(self._memory, before)
        else:
            held = self._own
        self._own = np.zeros((count, self._columns), dtype=np.int32)
        if held is not None:
            self._own[:before] = held
        self._memory = None
        return self._own

    def _of(self, memory: mmap.mmap, count: int) -> NDArray[np.int32]:
        whole = np.frombuffer(memory, dtype=np.int32, count=count * self._columns)
        return whole.reshape(count, self._columns)
=======
        try:
            self._memory = self._resized(BYTES * max(count * self._columns, 1))
        except OSError:
            return False
        self._count = count
        return True
>>>>>>> 03a6f6c (A limit on the size of files costs the voxels that a node shows nothing: they are then in memory of the usual kind)

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
