"""Compiles loops over numbers to machine code.

The code is kept on disk, beside the source or in the user's cache folder, and only loaded later.
It is made anew when the kernel's own file changes, which is all that is looked at: a kernel must
not call kernels of other files, nor use their constants.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Timer
from typing import Any, TypeVar, cast

import numba

Function = TypeVar('Function', bound=Callable[..., Any])

LONG = 2.0
"""Seconds after which somebody who waits is told why; loading takes a fraction of one."""


def kernel(function: Function) -> Function:
    """Have a function compiled on its first call with arguments of some types.

    Args:
        function: loops over numbers and arrays, as Numba knows them. Numbers follow IEEE 754: what
            is divided by zero is no error.

    Returns:
        The function, which runs without Python's lock, so that threads overlap. Its code is kept
        on disk where that is possible.
    """
    compiled: Any = numba.njit(nogil=True, error_model='numpy')(function)
    with suppress(RuntimeError):  # no folder can be written to
        compiled.enable_caching()
        save = compiled._cache.save_overload

        def save_if_possible(*args: Any) -> None:
            with suppress(OSError):  # such as a full disk
                save(*args)

        compiled._cache.save_overload = save_if_possible
    return cast(Function, compiled)


@contextmanager
def waiting() -> Iterator[None]:
    """Tell whoever waits: logs a warning if what is compiled inside the block takes long.

    Code that was kept on disk is loaded in a fraction of a second, and nothing is said.
    """
    text = 'compiling; this takes about 15 s and is needed once after an installation'
    timer = Timer(LONG, logging.getLogger('incremental_mapper').warning, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
