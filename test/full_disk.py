"""What a full disk does to a program that writes."""

import contextlib
import resource


@contextlib.contextmanager
def largest_file(size):
    """No file may become larger while the block runs, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
