"""Files of records that tell where they were cut off: a line that names the format, then records.

A record is a head, its kind (a letter), the length and the CRC-32 of its content and the CRC-32 of
all that, and its content. What was being written when the power went is no whole record.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from incremental_mapper.errors import InputError

FORMAT = 1
TITLE = b'incremental_mapper journal '
HEAD = struct.Struct('<cQI')
"""Kind, length and checksum of the content; the checksum of these follows."""
SUM = struct.Struct('<I')
PIECE = 1 << 24
"""Bytes that are looked at together."""


@dataclass(frozen=True, slots=True)
class Record:
    """A whole record of a file: its kind, and where its content lies."""

    kind: bytes
    offset: int
    size: int

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.offset + self.size


@dataclass(frozen=True, slots=True)
class Damage:
    """What follows the last whole record of a file.

    Attributes:
        offset: Where that record ends.
        size: Bytes behind it.
        inside: Whether there is more wrong than that a record was cut off: a broken disk, or, where
            the power went, blocks of the last moments that never reached it.
    """

    offset: int
    size: int
    inside: bool


def title() -> bytes:
    """The line that a file begins with."""
    return TITLE + b'%d\n' % FORMAT


def frame(kind: bytes, content: bytes) -> bytes:
    """A record as it is written.

    Args:
        kind: One letter.
        content: Any bytes.
    """
    head = HEAD.pack(kind, len(content), zlib.crc32(content))
    return head + SUM.pack(zlib.crc32(head)) + content


def records(path: Path, file: BinaryIO) -> Iterator[Record | Damage]:
    """The whole records of a file, in their order, each checked.

    Args:
        path: Its name, for messages.
        file: The file, open for reading.

    Yields:
        The records; at last the damage, where there is any.

    Raises:
        InputError: It is no such file, or has another format.
        OSError: It cannot be read.
    """
    end = file.seek(0, 2)
    offset = _after_title(path, file)
    while offset < end:
        found = _record(file, offset, end)
        if isinstance(found, Damage):
            yield found
            return
        yield found
        offset = found.end


def content(file: BinaryIO, record: Record) -> bytes:
    """The content of a record.

    Args:
        file: The file that it was found in.
        record: The record.
    """
    file.seek(record.offset)
    return file.read(record.size)


def _after_title(path: Path, file: BinaryIO) -> int:
    file.seek(0)
    line = file.read(len(TITLE) + 12).partition(b'\n')[0] + b'\n'
    if line == title():
        return len(line)
    version = line[len(TITLE) : -1]
    if line.startswith(TITLE) and version.isdigit():
        raise InputError(
            f'{path}: is a journal of format {version.decode()}, this version of the program reads '
            f'{FORMAT}; recover it with the version that wrote it'
        )
    raise InputError(f'{path}: is no journal of a map, or its beginning is damaged')


def _record(file: BinaryIO, offset: int, end: int) -> Record | Damage:
    file.seek(offset)
    head, head_sum = file.read(HEAD.size), file.read(SUM.size)
    if len(head_sum) < SUM.size:
        return Damage(offset, end - offset, False)
    if SUM.unpack(head_sum)[0] != zlib.crc32(head):
        return Damage(offset, end - offset, True)
    kind, size, wanted = HEAD.unpack(head)
    begin = offset + HEAD.size + SUM.size
    if begin + size > end:
        return Damage(offset, end - offset, False)
    found, left = 0, size
    while left > 0:
        piece = file.read(min(left, PIECE))
        found = zlib.crc32(piece, found)
        left -= len(piece)
    if found != wanted:
        return Damage(offset, end - offset, True)
    return Record(kind, begin, size)
