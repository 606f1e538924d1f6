"""Compiles loops over numbers to machine code.

The code is kept on disk, beside the source or in the user's cache folder, and only loaded later.
It is made anew when the kernel's own file changes, which is all that is looked at: a kernel must
not call kernels of other files, nor use their constants.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar('Function', bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function on its first call with arguments of some types; threads may overlap."""
    try:
        compiled = numba.njit(cache=True, nogil=True, error_model='numpy')(function)
    except RuntimeError:  # no folder can be written to
        compiled = numba.njit(nogil=True, error_model='numpy')(function)
    return cast(Function, compiled)
