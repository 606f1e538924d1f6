"""A program that nobody waits for within milliseconds gives others the processor less often."""

import contextlib
import os


def work_in_batches() -> None:
    """Go on until a time slice ends, and let processes that are started do the same.

    A mapper and its LiDARs' processes wake each other for every scan. Where there are more of them
    than cores, each would interrupt another then, some hundred times a second, and the caches are
    filled anew each time: that costs a tenth of a whole run. It is for a program of its own.
    """
    with contextlib.suppress(OSError, AttributeError):  # it is not Linux, or not allowed
        if os.sched_getscheduler(0) == os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
