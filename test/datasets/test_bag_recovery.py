"""Bags whose recorder was killed, or whose metadata lie: read, or the command named."""

import re
import shutil
import sqlite3
from pathlib import Path

import pytest
from bag_files import USUAL, count, write_bag
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from incremental_mapper.datasets.open import open_source
from incremental_mapper.errors import InputError
from incremental_mapper.ros.player.recording import Recording

EXPECTED = {'points_left': 4, 'points_right': 4, 'imu': 40, 'gnss': 8}
MANY = 200
"""Times the usual messages; several chunks of 1 MB."""
LONG = [(name, kind, phase, period, n * MANY) for name, kind, phase, period, n in USUAL]


def said(source, word) -> list[str]:
    found = [finding.line() for finding in source.info.findings]
    return [text for text in (*source.info.notes, *found) if word in text]


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize('identifier', ['""', 'rosbag_v2', 'mcap2'])
def test_a_wrong_storage_identifier_is_told_by_the_ending(tmp_path, plugin, identifier):
    bag = write_bag(tmp_path / 'bag', plugin=plugin)
    path = bag / 'metadata.yaml'
    text = re.sub('storage_identifier: .*', f'storage_identifier: {identifier}', path.read_text())
    path.write_text(text)
    source = open_source(bag, {})
    assert count(source) == EXPECTED and source.drops == {}
    assert len(said(source, 'unknown_storage')) == 1
    assert path.read_text() == text


@pytest.mark.parametrize(
    ('plugin', 'identifier'), [(StoragePlugin.MCAP, 'sqlite3'), (StoragePlugin.SQLITE3, 'mcap')]
)
def test_the_identifier_of_the_other_format_is_not_believed(tmp_path, plugin, identifier):
    bag = write_bag(tmp_path / 'bag', plugin=plugin)
    path = bag / 'metadata.yaml'
    path.write_text(
        re.sub('storage_identifier: .*', f'storage_identifier: {identifier}', path.read_text())
    )
    source = open_source(bag, {})
    assert count(source) == EXPECTED and source.drops == {}
    assert len(said(source, 'unknown_storage')) == 1


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_whose_one_file_was_renamed_is_read(tmp_path, plugin):
    bag = write_bag(tmp_path / 'bag', plugin=plugin)
    file = next(path for path in bag.iterdir() if path.suffix in ('.mcap', '.db3'))
    file.rename(bag / f'monday{file.suffix}')
    source = open_source(bag, {})
    assert count(source) == EXPECTED and source.drops == {}


def test_a_bag_that_was_unpacked_by_hand_is_read(tmp_path):
    """Its metadata name the packed file still."""
    bag = write_bag(tmp_path / 'bag', plugin=StoragePlugin.SQLITE3)
    (file,) = bag.glob('*.db3')
    path = bag / 'metadata.yaml'
    text = path.read_text().replace(file.name, f'{file.name}.zstd')
    text = text.replace("compression_format: ''", 'compression_format: zstd')
    path.write_text(text.replace("compression_mode: ''", 'compression_mode: FILE'))
    source = open_source(bag, {})
    assert count(source) == EXPECTED and source.drops == {}


def test_sound_bags_have_nothing_to_mend(tmp_path):
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        source = open_source(write_bag(tmp_path / plugin.name, plugin=plugin), {})
        assert not said(source, 'metadata') and not said(source, '_bag')


def killed_recorder(folder: Path, tmp_path: Path) -> Path:
    """A database of which most stands in its write-ahead log still."""
    done = next(write_bag(tmp_path / 'done', plugin=StoragePlugin.SQLITE3).glob('*.db3'))
    live = tmp_path / 'live.db3'
    with sqlite3.connect(done) as whole:
        script = list(whole.iterdump())
    open_database = sqlite3.connect(live, isolation_level=None)
    open_database.execute('PRAGMA journal_mode=WAL')
    open_database.execute('PRAGMA wal_autocheckpoint=0')
    open_database.executescript('\n'.join(script))
    folder.mkdir()
    for file in tmp_path.glob('live.db3*'):
        if not file.name.endswith('-shm'):
            shutil.copy(file, folder / file.name)
    open_database.close()
    return folder / 'live.db3'


@pytest.mark.parametrize('as_folder', [True, False])
def test_a_database_with_its_log_is_read_from_a_copy(tmp_path, as_folder):
    file = killed_recorder(tmp_path / 'bag', tmp_path)
    before = {path.name: path.read_bytes() for path in file.parent.iterdir()}
    assert set(before) == {'live.db3', 'live.db3-wal'}
    source = open_source(file.parent if as_folder else file, {})
    assert count(source) == EXPECTED
    (note,) = said(source, 'unclosed_bag')
    assert 'wal_checkpoint' in note
    assert {path.name: path.read_bytes() for path in file.parent.iterdir()} == before


@pytest.mark.parametrize('mode', [None, CompressionMode.STORAGE])
@pytest.mark.parametrize('cut', ['tail', 'chunk', 'zeros'])
def test_a_truncated_file_is_read_up_to_the_damage(tmp_path, mode, cut):
    file = next(write_bag(tmp_path / 'whole', LONG, mode=mode).glob('*.mcap'))
    data = file.read_bytes()
    broken = tmp_path / 'broken.mcap'
    if cut == 'tail':
        broken.write_bytes(data[:-20])
    else:
        broken.write_bytes(data[: len(data) * 3 // 4] + b'\0' * (5000 if cut == 'zeros' else 0))
    source = open_source(broken, {})
    found = count(source)
    (note,) = said(source, 'truncated_bag')
    assert 'messages of' in note and 'mcap recover' in note
    if cut == 'tail':
        assert found == {sensor: n * MANY for sensor, n in EXPECTED.items()}
    else:
        assert all(0 < found[sensor] < n * MANY for sensor, n in EXPECTED.items())
    assert source.drops == {}


def test_a_file_without_one_whole_chunk_is_refused(tmp_path):
    file = next(write_bag(tmp_path / 'whole').glob('*.mcap'))
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(InputError, match='cut off before its first chunk'):
        open_source(file, {})


@pytest.mark.parametrize(
    ('name', 'command'),
    [
        ('drive.bag.active', 'rosbag reindex'),
        ('drive.mcap.zstd', 'zstd -d'),
        ('drive_0.db3.zstd', 'zstd -d'),
    ],
)
@pytest.mark.parametrize('as_folder', [True, False])
def test_the_command_is_named_that_makes_it_a_bag(tmp_path, name, command, as_folder):
    (tmp_path / name).write_bytes(b'anything')
    path = tmp_path if as_folder else tmp_path / name
    with pytest.raises(InputError, match=command):
        open_source(path, {})
    with pytest.raises(InputError, match=command):
        Recording(path)


def test_split_bags_with_the_times_of_one_part_are_read_whole(tmp_path):
    bag = write_bag(tmp_path / 'bag', LONG)
    path = bag / 'metadata.yaml'
    text = re.sub(r'nanoseconds: \d+', 'nanoseconds: 1000000000', path.read_text())
    text = re.sub(r'message_count: \d{3,}', 'message_count: 4', text)
    path.write_text(text)
    with Recording(bag) as recording:
        names = [topic.name for topic in recording.topics]
        played = list(recording.messages(names, recording.start, recording.end))
        assert len(played) == sum(n for *_, n in LONG)
        assert sum(topic.count for topic in recording.topics) == len(played)
        (note,) = recording.notes
    assert 'times are of 1.0 s' in note and 'counts are of' in note
    source = open_source(bag, {})
    assert count(source) == source.info.counts and source.info.duration > 20.0
