"""Opening an input of any kind."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from incremental_mapper.datasets.bag_files import STORAGE_SUFFIXES, unfinished
from incremental_mapper.datasets.bags import BagSource
from incremental_mapper.datasets.kaist import KaistSource
from incremental_mapper.datasets.kaist_files import is_kaist_folder
from incremental_mapper.datasets.source import Source
from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.errors import InputError

__all__ = ['open_source', 'read_truth']

_EXPECTED = (
    'a rosbag2 folder, a .mcap, .db3 or ROS 1 .bag file, a KAIST folder (with sensor_data/) '
    'or a folder of <stamp>.bin scans'
)


def open_source(path: Path, tree: Mapping[str, Any] | None = None) -> Source:
    """Open an input of any kind.

    Args:
        path: a KAIST folder, a folder of ``<stamp>.bin`` scans, a rosbag2 folder or file, or a
            ROS 1 bag.
        tree: the user's settings, as nested dictionaries; topics, names of LiDARs and time offsets
            in it count. None leaves all that to the input.

    Returns:
        The input, opened and checked, with nothing read yet but its tables and headers.

    Raises:
        InputError: the path is missing, is none of these, or cannot be used.
        ConfigError: a setting is wrong.
    """
    if not path.exists():
        raise InputError(f'{path}: does not exist; expected {_EXPECTED}')
    bags = {*STORAGE_SUFFIXES, '.bag'}
    if path.is_file():
        if path.suffix in bags:
            return BagSource(path, tree)
        raise InputError(unfinished(path) or f'{path}: is no bag; expected {_EXPECTED}')
    try:
        names = [file.name for file in path.iterdir()]
    except OSError as error:
        raise InputError(f'{path}: cannot be read ({error.strerror})') from error
    if is_kaist_folder(path):
        return KaistSource(path, tree)
    suffixes = {Path(name).suffix for name in names}
    if 'metadata.yaml' in names or suffixes & bags:
        return BagSource(path, tree)
    if '.bin' in suffixes:
        return KaistSource(path, tree)
    for name in sorted(names):
        if remedy := unfinished(path / name):
            raise InputError(remedy)
    what = f'holds {", ".join(sorted(names)[:5])}' if names else 'is empty'
    raise InputError(f'{path}: {what}; expected {_EXPECTED}')
