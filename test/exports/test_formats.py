"""How formats are found, what is missing for them, and that no torn file is left."""

import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from finished_runs import write_run

from incremental_mapper.errors import ConfigError, OutputError
from incremental_mapper.exports import formats as registry
from incremental_mapper.exports.formats import (
    Content,
    Format,
    check_formats,
    export,
    find_format,
    formats,
)


def count_poses(run, path, crs):
    path.write_text(str(len(run.trajectory)))
    return ('counted',)


COUNT = Format('count', Content.TRAJECTORY, count_poses, ('.count',))


@pytest.fixture
def others(monkeypatch):
    """Make entry points stand for what another package would have installed."""

    def install(*entries):
        found = [EntryPoint(name, value, registry.GROUP) for name, value in entries]
        monkeypatch.setattr(registry, 'entry_points', lambda group: found)
        registry._others.cache_clear()

    yield install
    registry._others.cache_clear()


def test_a_format_of_another_package_is_one_like_all(others, tmp_path):
    others(('count', 'test_formats:COUNT'))
    run = write_run(tmp_path / 'run')
    form = find_format(tmp_path / 'a.count')
    assert form.file_name == 'trajectory.count'
    assert export(run, form, tmp_path / 'a.count') == ('counted',)
    assert (tmp_path / 'a.count').read_text() == '20'
    check_formats(['laz' if not formats()['laz'].missing() else 'pcd', 'count'])


@pytest.mark.parametrize(
    ('entry', 'words'),
    [
        (('x', 'no_such_module:X'), 'cannot be loaded'),
        (('x', 'test_formats:count_poses'), 'is no Format'),
        (('ply', 'incremental_mapper.exports.formats:BUILT_IN'), 'is no Format'),
    ],
)
def test_a_format_that_is_none_is_named(others, entry, words):
    others(entry)
    with pytest.raises(ConfigError, match=words):
        formats()


def test_a_name_belongs_to_one_format(others):
    others(('count', 'test_formats:COUNT'), ('more', 'test_formats:COUNT'))
    with pytest.raises(ConfigError, match='uninstall one'):
        formats()


def test_suffix_and_name_are_looked_up():
    assert find_format(Path('a.LAZ')).name == 'laz'
    assert find_format(Path('a.txt')).name == 'kitti'
    assert find_format(Path('a.txt'), 'csv').name == 'csv'
    with pytest.raises(ConfigError, match=r"the suffix '.xyz' tells no format; .*\.laz"):
        find_format(Path('a.xyz'))
    with pytest.raises(ConfigError, match=r"is 'lax'; known formats: ply, pcd, laz"):
        find_format(Path('a.xyz'), 'lax')
    with pytest.raises(ConfigError, match=r"map.formats is 'lax'"):
        check_formats(['ply', 'lax'])


def test_a_missing_library_names_the_extra(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, 'laspy', None)
    run = write_run(tmp_path / 'run')
    words = r'laz needs laspy.*missing; pip install "incremental_mapper\[formats\]"'
    with pytest.raises(OutputError, match=words):
        export(run, find_format(Path('a.laz')), tmp_path / 'a.laz')
    with pytest.raises(ConfigError, match=f'map.formats: {words}'):
        check_formats(['laz'])


def test_what_fails_halfway_leaves_the_file_that_was_there(tmp_path):
    def fail(run, path, crs):
        path.write_text('half')
        raise OSError(28, 'No space left on device')

    run = write_run(tmp_path / 'run')
    (tmp_path / 'a.x').write_text('before')
    with pytest.raises(OutputError, match='No space left'):
        export(run, Format('x', Content.MAP, fail, ('.x',)), tmp_path / 'a.x')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['a.x', 'run']
    assert (tmp_path / 'a.x').read_text() == 'before'
