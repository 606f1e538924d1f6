"""The drive that is harmed here, and the generators of the benchmarks."""

import sys
from pathlib import Path

import pytest

# Behind all others: a benchmark may be called as a library is.
sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))


@pytest.fixture(scope='session')
def recording(light_bag, light_drive):
    """``light_drive`` as messages."""
    from lies.recording import Recording, read_items

    from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
    from incremental_mapper.settings import read_yaml

    settings = read_yaml(light_bag / SETTINGS_FILE)
    return Recording(tuple(read_items(light_bag)), settings, light_drive)
