"""Files of a bag that were not finished well, or whose metadata are not theirs."""

from collections.abc import Sequence
from dataclasses import dataclass

from incremental_mapper.checks.finding import Finding, Severity


@dataclass(frozen=True, slots=True)
class CutFile:
    """A file without its end: what is read of it, and how many of its bytes are lost."""

    name: str
    messages: int
    seconds: float
    lost_bytes: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class UnclosedFile:
    """A database that its recorder did not close, and what it left ``beside`` it."""

    name: str
    beside: tuple[str, ...]
    beside_bytes: int


def truncated_bag(files: Sequence[CutFile]) -> list[Finding]:
    """Files that are cut off."""
    if not files:
        return []
    parts = [
        f'{file.name} is cut off, {file.messages} messages of {file.seconds:.1f} s are read, the '
        f'last {file.lost_bytes} of {file.size_bytes} bytes are lost'
        for file in files
    ]
    remedy = '"mcap recover" makes a whole file of it'
    return [Finding('truncated_bag', Severity.WARNING, '', '; '.join(parts), remedy)]


def unclosed_bag(files: Sequence[UnclosedFile]) -> list[Finding]:
    """Databases with a log that is not written back."""
    if not files:
        return []
    parts = [
        f'the recorder did not close {file.name}; the {file.beside_bytes / 1e6:.1f} MB in '
        f'{" and ".join(file.beside)} are read from a temporary copy'
        for file in files
    ]
    commands = [f'sqlite3 {file.name} "PRAGMA wal_checkpoint(TRUNCATE);"' for file in files]
    remedy = f'{" and ".join(commands)} in its folder finishes it'
    return [Finding('unclosed_bag', Severity.MENDED, '', '; '.join(parts), remedy)]


def unknown_storage(identifiers: Sequence[str]) -> list[Finding]:
    """Storage identifiers of ``metadata.yaml`` that name no known format, or another one."""
    if not identifiers:
        return []
    text = f'metadata.yaml: storage_identifier is {identifiers[0]!r}, which its files are not'
    remedy = 'the ending of the files tells what they are; "ros2 bag reindex" writes it anew'
    return [Finding('unknown_storage', Severity.MENDED, '', text, remedy)]


def wrong_metadata(
    told: tuple[float, int], found: tuple[float, int], times: bool, counts: bool
) -> list[Finding]:
    """Times or counts of ``metadata.yaml`` that are not those of its files.

    Args:
        told: Seconds and messages by the metadata.
        found: The same by the files.
        times: Whether files begin before or end after what is told.
        counts: Whether a topic has more messages than is told.
    """
    wrong = []
    if times:
        wrong.append(f'times are of {told[0]:.1f} s, its files have {found[0]:.1f} s')
    if counts:
        wrong.append(f'counts are of {told[1]} messages, its files have {found[1]}')
    if not wrong:
        return []
    text = f'metadata.yaml: {" and ".join(wrong)}'
    remedy = 'the files are believed; "ros2 bag reindex" writes it anew'
    return [Finding('wrong_metadata', Severity.MENDED, '', text, remedy)]
