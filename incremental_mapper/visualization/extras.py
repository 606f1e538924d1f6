"""Libraries that come with the extra ``report``: without them their files are left out."""

from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec

INSTALL = 'pip install "incremental_mapper[report]"'
LIBRARIES = {
    'pictures': 'matplotlib',
    'candidates.parquet': 'pyarrow',
    'report.html': 'jinja2',
}
"""What is written, and the library that it needs."""


def importable(files: str) -> bool:
    """Tell whether files can be written.

    Args:
        files: A key of ``LIBRARIES``.
    """
    try:
        import_module(LIBRARIES[files])
    # One that was built against another library than is installed raises what it likes.
    except Exception:
        return False
    return True


def installed(files: str) -> bool:
    """Tell at once whether a library is there; only ``importable`` knows whether it works.

    Args:
        files: A key of ``LIBRARIES``.
    """
    try:
        return find_spec(LIBRARIES[files]) is not None
    except ValueError:  # something else has its name
        return False


def left_out(files: Iterable[str]) -> str | None:
    """One line on the files that cannot be written, and how they can be.

    Args:
        files: Keys of ``LIBRARIES`` that are wanted.

    Returns:
        None where all can be written.
    """
    return missing_files([name for name in files if not importable(name)])


def missing_files(names: Sequence[str]) -> str | None:
    """As ``left_out``, of files that are known to be missing."""
    if not names:
        return None
    libraries = ', '.join(dict.fromkeys(LIBRARIES[name] for name in names))
    verb = 'is' if len(names) == 1 else 'are'
    return f'no {" and no ".join(names)}: {libraries} {verb} missing; {INSTALL}'
