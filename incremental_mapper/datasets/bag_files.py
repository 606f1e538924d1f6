"""The files of a bag and the topics in them; knows of no sensor.

The player needs this and no more: it starts without the libraries of the mapper.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rosbags.typesys import Stores, get_typestore

from incremental_mapper.datasets.bag_recovery import BagReader
from incremental_mapper.errors import InputError

STORAGE_SUFFIXES = ('.mcap', '.db3')


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: name, type as ``package/msg/Type``, number of messages."""

    name: str
    type: str
    count: int


def open_bag(path: Path) -> BagReader:
    """Open a bag.

    Args:
        path: a rosbag2 folder, a .mcap, .db3 or ROS 1 .bag file, or a folder of .bag files.

    Returns:
        An open reader, which whoever called has to close; its notes say what was mended.

    Raises:
        InputError: the path is no bag, or the bag cannot be read.
    """
    files = bag_files(path)
    try:
        reader = BagReader(files, default_typestore=get_typestore(Stores.ROS2_JAZZY))
        reader.open()
    # Of a damaged file the library raises whatever its parser stumbles over.
    except Exception as error:
        reason = ' '.join(str(error).split()) or type(error).__name__
        raise InputError(
            f'{path}: cannot be read as a bag ({reason}); an interrupted recording '
            'may need "ros2 bag reindex", "mcap recover" or "rosbag reindex"'
        ) from error
    return reader


def bag_files(path: Path) -> list[Path]:
    """Find the files of a bag.

    Args:
        path: see ``open_bag``.

    Returns:
        What the bag library has to open: a rosbag2 folder itself, else files.

    Raises:
        InputError: the path is no bag.
    """
    if path.is_file():
        if path.suffix in (*STORAGE_SUFFIXES, '.bag'):
            return [path]
        raise InputError(
            unfinished(path) or f'{path}: is no bag; expected a .mcap, .db3 or .bag file'
        )
    if not path.is_dir():
        raise InputError(f'{path}: does not exist')
    storage = sorted(file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES)
    metadata = path / 'metadata.yaml'
    if metadata.is_file():
        # The one file there tells all by itself where it was renamed, or unpacked, since.
        text = metadata.read_text(errors='replace')
        return [path] if len(storage) != 1 or _names(text, storage[0].name) else storage
    if len(storage) == 1:
        return storage
    if storage:
        raise InputError(
            f'{path}: has {len(storage)} bag files but no metadata.yaml; '
            'make one with "ros2 bag reindex", or give one of the files'
        )
    ros1 = sorted(path.glob('*.bag'))
    if not ros1:
        for file in sorted(path.iterdir()):
            if remedy := unfinished(file):
                raise InputError(remedy)
        raise InputError(f'{path}: is no bag; expected metadata.yaml, a .mcap, .db3 or .bag file')
    return list(ros1)


def _names(text: str, name: str) -> bool:
    """Whether a text has the name of a file, and not as a part of another one."""
    return re.search(rf'(?<![\w.-]){re.escape(name)}(?![\w.-])', text) is not None


def unfinished(path: Path) -> str | None:
    """What to do with a file that becomes a bag by one command; None for all other files.

    Args:
        path: a file.
    """
    if path.name.endswith('.bag.active'):
        return (
            f'{path}: its recorder did not close it; "rosbag reindex {path}", then rename it to '
            f'{path.stem}'
        )
    if path.suffix == '.zstd' and Path(path.stem).suffix in STORAGE_SUFFIXES:
        return (
            f'{path}: is compressed and has no metadata.yaml beside it that says so; '
            f'"zstd -d {path} -o {path.with_suffix("")}", then give that file'
        )
    return None


def describe_topics(topics: Sequence[Topic]) -> str:
    """One line on everything in a bag, for error messages."""
    if not topics:
        return 'The bag has no topics.'
    lines = [f'{t.name} ({t.type}, {t.count} messages)' for t in sorted(topics, key=str)]
    return 'The bag has ' + ', '.join(lines)
