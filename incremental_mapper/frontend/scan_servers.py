"""Processes that will prepare a LiDAR's scans, started before it is known whose.

They take half a second to import what they need. A program that is about to import more than that
starts them first, and ends those that were not needed.
"""

from incremental_mapper.helper_process import Helper, start

_SURROUNDINGS = {
    # The processes share the cores among themselves; their libraries' threads would only compete.
    'OMP_NUM_THREADS': '1',
    'OPENBLAS_NUM_THREADS': '1',
    # Memory for a cloud is kept for the next one. By default glibc gives large pieces back at once,
    # and the pages that the next cloud gets anew cost half as much as thinning it.
    'MALLOC_MMAP_THRESHOLD_': str(64 << 20),
    'MALLOC_TRIM_THRESHOLD_': str(64 << 20),
}

_ahead: list[Helper] = []


def start_ahead(count: int) -> None:
    """Start so many, for ``scan_server`` to hand out; ``let_go`` must follow."""
    _ahead.extend(_start() for _ in range(count))


def scan_server() -> Helper:
    """A process that serves as ``odometry_process`` says, and has served nobody yet."""
    while _ahead:
        server = _ahead.pop()
        if server.poll() is None:
            return server
        server.communicate()
    return _start()


def let_go() -> None:
    """End those that nobody has taken."""
    while _ahead:
        server = _ahead.pop()
        server.kill()
        server.communicate()


def _start() -> Helper:
    return start('incremental_mapper.frontend.odometry_process', _SURROUNDINGS)
