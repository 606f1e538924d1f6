"""What a run is recognised by: its input, its settings, and the code that makes its numbers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import incremental_mapper
from incremental_mapper.evaluation import cache
from incremental_mapper.evaluation.jobs import plan_jobs


@pytest.fixture
def small_input(tmp_path):
    folder = tmp_path / 'drive'
    (folder / 'sensor_data').mkdir(parents=True)
    (folder / 'sensor_data' / 'scan.bin').write_bytes(b'1234')
    return folder


def keys(small_input, tree=None, truth=None):
    out = small_input.parent / 'out'
    return {
        job.key for job in plan_jobs([small_input], out, ['base', 'mom'], tree or {}, 'x', truth)
    }


def test_keys_depend_on_input_settings_strategy_and_truth(small_input, tmp_path):
    first = keys(small_input)
    assert len(first) == 2
    assert keys(small_input) == first
    assert not keys(small_input, {'mom': {'radius': 1.0}}) & first
    (tmp_path / 'truth.tum').write_text('0.0 0 0 0 0 0 0 1\n')
    with_truth = keys(small_input, truth=tmp_path / 'truth.tum')
    assert not with_truth & first
    (tmp_path / 'truth.tum').write_text('0.5 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n')
    assert not keys(small_input, truth=tmp_path / 'truth.tum') & with_truth


def _grow(small_input):
    (small_input / 'sensor_data' / 'scan.bin').write_bytes(b'12345')


def _touch(small_input):
    os.utime(small_input / 'sensor_data' / 'scan.bin', ns=(1, 1))


def _add(small_input):
    (small_input / 'sensor_data' / 'more.bin').touch()


def _rename(small_input):
    (small_input / 'sensor_data' / 'scan.bin').rename(small_input / 'sensor_data' / 'other.bin')


def _truth_beside(small_input):
    (small_input.parent / 'ground_truth.tum').write_text('0.0 0 0 0 0 0 0 1\n')


@pytest.mark.parametrize('change', [_grow, _touch, _add, _rename, _truth_beside])
def test_every_change_of_the_input_is_seen(small_input, change):
    before = keys(small_input)
    change(small_input)
    assert not keys(small_input) & before


def test_keys_depend_on_the_code_of_a_strategy_of_ones_own(monkeypatch, small_input, tmp_path):
    site = tmp_path / 'site'
    (site / 'my_rules').mkdir(parents=True)
    (site / 'my_rules' / '__init__.py').touch()
    (site / 'my_rules' / 'rule.py').write_text('first = None\n')
    (site / 'my_rules-1.0.dist-info').mkdir()
    (site / 'my_rules-1.0.dist-info' / 'METADATA').write_text('Name: my_rules\nVersion: 1.0\n')
    (site / 'my_rules-1.0.dist-info' / 'entry_points.txt').write_text(
        '[incremental_mapper.strategies]\nmine = my_rules.rule:first\n'
    )
    monkeypatch.syspath_prepend(site)

    def keys():
        jobs = plan_jobs([small_input], tmp_path / 'out', ['base', 'mine'], {}, 'x')
        return {job.strategy: job.key for job in jobs}

    before = keys()
    assert keys() == before
    (site / 'my_rules' / 'rule.py').write_text('first = 1\n')
    changed = keys()
    assert changed['base'] == before['base'] and changed['mine'] != before['mine']


@pytest.fixture
def copy(monkeypatch, tmp_path):
    """A package of one empty file for each room, whose code the cache looks at."""
    root = tmp_path / 'package'
    for room in [path for path in PACKAGE.iterdir() if (path / '__init__.py').is_file()]:
        (root / room.name).mkdir(parents=True)
        (root / room.name / 'code.py').touch()
    (root / '__init__.py').touch()
    monkeypatch.setattr(incremental_mapper, '__file__', str(root / '__init__.py'))
    yield root
    cache.own_program.cache_clear()


PACKAGE = Path(incremental_mapper.__file__).parent
IDLE = {'cli', 'evaluation', 'ros', 'visualization'}
"""Rooms whose code a run's numbers do not depend on."""


def code():
    cache.own_program.cache_clear()
    return cache.own_program()['code']


def test_program_knows_its_version():
    assert cache.own_program()['incremental_mapper'] == incremental_mapper.__version__


def test_code_counts_room_by_room(copy):
    before, counting = code(), set()
    for path in [copy / '__init__.py', *copy.glob('*/code.py')]:
        path.write_text('x = 1\n')
        if code() != before:
            counting.add(path.parent.name)
        path.write_text('')
    rooms = {path.parent.name for path in copy.glob('*/code.py')}
    assert counting == (rooms - IDLE) | {copy.name}
    assert rooms >= IDLE | {'results', 'mapping'}


def test_a_file_that_moves_to_another_room_counts(copy):
    (copy / 'mapping' / 'code.py').write_text('x = 1\n')
    before = code()
    (copy / 'mapping' / 'code.py').rename(copy / 'results' / 'other.py')
    assert code() != before


def test_everything_that_a_run_loads_counts(light_drive, tmp_path):
    """Whatever module maps a drive and writes its files is in a room that counts, or draws."""
    script = (
        'import sys\n'
        'from incremental_mapper.results.offline_run import map_into\n'
        'from incremental_mapper.results.opened_drive import open_drive\n'
        'from pathlib import Path\n'
        "tree = {'selection': {'strategy': 'base'}, 'odometry': {'processes': False}}\n"
        "map_into(Path(sys.argv[2]), open_drive(Path(sys.argv[1]), tree, 'test'))\n"
        "print(*(name for name in sys.modules if name.startswith('incremental_mapper.')))\n"
    )
    (tmp_path / 'out').mkdir()
    done = subprocess.run(
        [sys.executable, '-c', script, light_drive, tmp_path / 'out'],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = [name.split('.') for name in done.stdout.split()]
    assert ['incremental_mapper', 'results', 'candidate_table'] in loaded
    assert {words[1] for words in loaded} & IDLE == {'visualization'}
