"""Files of records: whole ones are found again, and what is not whole is known for it."""

import io
from pathlib import Path

import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.results.journal.record_file import (
    FORMAT,
    TITLE,
    Damage,
    Record,
    content,
    frame,
    records,
    title,
)

HERE = Path('here.journal')
PARTS = [(b'B', b'the beginning'), (b'P', bytes(200)), (b'W', b''), (b'W', b'the last window')]
WHOLE = title() + b''.join(frame(*part) for part in PARTS)
LAST = len(WHOLE) - len(frame(*PARTS[-1]))


def read(data):
    """What is found in a file: kinds and contents, and the damage."""
    file = io.BytesIO(data)
    found = list(records(HERE, file))
    parts = [(item.kind, content(file, item)) for item in found if isinstance(item, Record)]
    return parts, next((item for item in found if isinstance(item, Damage)), None)


def test_whole_records_come_back():
    assert read(WHOLE) == (PARTS, None)


@pytest.mark.parametrize('size', range(LAST + 1, len(WHOLE)))
def test_last_record_cut_off_at_any_byte_is_dropped(size):
    parts, damage = read(WHOLE[:size])
    assert parts == PARTS[:-1]
    assert damage == Damage(LAST, size - LAST, False)


@pytest.mark.parametrize('place', range(LAST, len(WHOLE)))
def test_last_record_with_any_byte_changed_is_dropped(place):
    changed = bytearray(WHOLE)
    changed[place] ^= 0x40
    parts, damage = read(bytes(changed))
    assert parts == PARTS[:-1]
    assert damage == Damage(LAST, len(WHOLE) - LAST, True)


def test_zeros_that_a_power_cut_leaves_are_damage():
    parts, damage = read(WHOLE + bytes(5000))
    assert parts == PARTS
    assert damage == Damage(len(WHOLE), 5000, True)


def test_what_lies_behind_a_damaged_record_is_not_read():
    changed = bytearray(WHOLE)
    changed[len(title()) + len(frame(*PARTS[0])) + 100] ^= 1
    parts, damage = read(bytes(changed))
    assert parts == PARTS[:1] and damage is not None and damage.inside


@pytest.mark.parametrize('data', [b'', b'ply\n', TITLE, TITLE + b'x\n', b'\0' * 100])
def test_other_files_are_refused(data):
    with pytest.raises(InputError, match=r'here.journal: is no journal of a map'):
        read(data)


def test_another_format_is_refused_with_both_numbers():
    with pytest.raises(InputError, match=rf'of format {FORMAT + 1}, .* reads {FORMAT}'):
        read(TITLE + b'%d\n' % (FORMAT + 1) + frame(*PARTS[0]))
