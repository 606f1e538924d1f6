"""Bags that were not finished, not indexed, or written with wrong metadata; folders."""

import re
import shutil
import sqlite3
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from lies.lie import Verdict, lie
from lies.recording import STORE, Recording, restamped, stamp_of

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND


def _only(folder: Path, ending: str) -> Path:
    return next(folder.glob(f'*{ending}'))


@lie(MENDED, WARNED, about=r'cut|truncated', factor=2.0)
def cut_mcap(drive: Recording, folder: Path) -> Path:
    """MCAP cut off at 80 % of its bytes."""
    bag = drive.write(folder / 'bag')
    file = _only(bag, '.mcap')
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 8 // 10])
    return bag


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=r'wal|metadata|recover|reindex',
)
def wal_sqlite(drive: Recording, folder: Path) -> Path:
    """SQLite with half of its messages in a WAL, and no metadata."""
    written = drive.write(folder / 'written', StoragePlugin.SQLITE3)
    source = _only(written, '.db3')
    bag = folder / 'bag'
    bag.mkdir()
    shutil.copy(source, folder / 'whole.db3')
    # The half of the messages is written while the WAL is on; the files are copied before it ends.
    connection = sqlite3.connect(folder / 'whole.db3')
    rows = connection.execute('select * from messages order by timestamp').fetchall()
    half = len(rows) // 2
    connection.execute('delete from messages where timestamp >= ?', (rows[half][2],))
    connection.commit()
    connection.execute('vacuum')
    connection.execute('pragma journal_mode=wal')
    connection.execute('pragma wal_autocheckpoint=0')
    marks = ','.join('?' * len(rows[0]))
    connection.executemany(f'insert or ignore into messages values ({marks})', rows[half:])
    connection.commit()
    for path in folder.glob('whole.db3*'):
        shutil.copy(path, bag / path.name.replace('whole', 'bag_0'))
    connection.close()
    drive.write_settings(bag)
    return bag


@lie(
    MENDED,
    SOUND,
    WARNED,
    about=r'metadata',
)
def wrong_metadata(drive: Recording, folder: Path) -> Path:
    """Metadata that count half of the messages and of the time."""
    bag = drive.write(folder / 'bag')
    path = bag / 'metadata.yaml'
    halve = re.compile(r'(message_count: |nanoseconds: )(\d{1,12})$', re.MULTILINE)
    path.write_text(halve.sub(lambda m: f'{m[1]}{int(m[2]) // 2}', path.read_text()))
    return bag


@lie(MENDED, SOUND, WARNED, REFUSED, about=r'metadata|reindex')
def no_metadata(drive: Recording, folder: Path) -> Path:
    """No metadata.yaml beside the MCAP."""
    bag = drive.write(folder / 'bag')
    (bag / 'metadata.yaml').unlink()
    return bag


@lie(SOUND)
def compressed_file(drive: Recording, folder: Path) -> Path:
    """Compressed file by file."""
    return drive.write(folder / 'bag', StoragePlugin.SQLITE3, CompressionMode.FILE)


@lie(SOUND)
def compressed_messages(drive: Recording, folder: Path) -> Path:
    """Compressed message by message."""
    return drive.write(folder / 'bag', StoragePlugin.SQLITE3, CompressionMode.MESSAGE)


@lie(
    MENDED,
    REFUSED,
    WARNED,
    about=r'active|reindex|index|settings|extrinsic|T_base_sensor',
)
def active_ros1(drive: Recording, folder: Path) -> Path:
    """A ROS 1 bag whose recorder was killed, .bag.active."""
    kinds = {'sensor_msgs/msg/PointCloud2', 'sensor_msgs/msg/Imu', 'sensor_msgs/msg/NavSatFix'}
    kept = [item for item in drive.items if item[2].__msgtype__ in kinds]
    whole = drive.with_items(kept).write_ros1(folder / 'whole.bag')
    path = folder / 'drive.bag.active'
    path.write_bytes(whole.read_bytes()[: whole.stat().st_size * 9 // 10])
    whole.unlink()
    return path


@lie(MENDED, REFUSED, SOUND, WARNED, about=r'zstd')
def mcap_zstd(drive: Recording, folder: Path) -> Path:
    """A .mcap.zstd alone."""
    bag = drive.write(folder / 'bag', StoragePlugin.MCAP, CompressionMode.FILE)
    path = _only(bag, '.zstd').rename(folder / 'drive.mcap.zstd')
    shutil.rmtree(bag)
    return path


@lie(SOUND, MENDED, WARNED, about=r'twice|loop|dup')
def looped(drive: Recording, folder: Path) -> Path:
    """The drive played twice in a loop into one bag."""
    length = drive.end - drive.start + 10**8
    again = [(t + length, topic, message) for t, topic, message in drive.items]
    return drive.plus(again).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'dup|twice')
def doubled(drive: Recording, folder: Path) -> Path:
    """Every message recorded twice, as by two publishers."""
    again = [(t + 1_000_000, topic, message) for t, topic, message in drive.items]
    return drive.plus(again).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'.')
def rotten(drive: Recording, folder: Path) -> Path:
    """Bytes turned over within every twentieth message."""
    from rosbags.rosbag2 import Writer

    rng = np.random.default_rng(9)
    bag = folder / 'bag'
    connections: dict[str, object] = {}
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for number, (logged, topic, message) in enumerate(drive.items):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = bytearray(STORE.serialize_cdr(message, kind))
            if number % 20 == 19:
                # Behind the header: what is said of the data, and the data.
                places = rng.integers(40, len(data), max(len(data) // 200, 4))
                for place in places:
                    data[place] ^= 0xFF
            writer.write(connections[topic], logged, bytes(data))
    drive.write_settings(bag)
    return bag


@lie(REFUSED, about=r'.')
def empty_bag(drive: Recording, folder: Path) -> Path:
    """An empty bag."""
    return drive.with_items([(t, n, m) for t, n, m in drive.items if n == '/fix'][:1]).write(
        folder / 'bag'
    )


@lie(REFUSED, MENDED, about=r'\.bin|name')
def numbered_scans(drive: Recording, folder: Path) -> Path:
    """A KAIST folder whose scans are 000000.bin, 000001.bin."""
    kaist = shutil.copytree(drive.folder, folder / 'kaist')
    for side in ('left', 'right'):
        for number, path in enumerate(sorted((kaist / 'sensor_data').glob(f'VLP_{side}/*.bin'))):
            path.rename(path.with_name(f'{number:06}.bin'))
    return kaist


@lie(MENDED, about=r'imu', drive='curve')
def kaist_in_g(drive: Recording, folder: Path) -> Path:
    """A KAIST folder whose IMU is in g."""
    kaist = shutil.copytree(drive.folder, folder / 'kaist')
    path = kaist / 'sensor_data' / 'xsens_imu.csv'
    rows = [line.split(',') for line in path.read_text().splitlines()]
    # stamp, orientation (4), Euler angles (3), rates (3), accelerations (3), magnetic field (3)
    for row in rows:
        row[11:14] = [f'{float(value) / 9.80665:.9f}' for value in row[11:14]]
    path.write_text('\n'.join(map(','.join, rows)) + '\n')
    return kaist


@lie(SOUND, MENDED, WARNED, about=r'storage|metadata')
def split_without_storage(drive: Recording, folder: Path) -> Path:
    """A split bag whose metadata name no storage."""
    bag = _split(drive, folder / 'bag')
    path = bag / 'metadata.yaml'
    path.write_text(re.sub(r'storage_identifier: \w+', "storage_identifier: ''", path.read_text()))
    return bag


@lie(WARNED, REFUSED, about=r'part|file|missing|lost|exist')
def part_missing(drive: Recording, folder: Path) -> Path:
    """A split bag whose second file is lost."""
    bag = _split(drive, folder / 'bag')
    sorted(bag.glob('*.mcap'))[1].unlink()
    return bag


@lie(SOUND, MENDED, WARNED, REFUSED, about=r'damaged|cut|truncated|recover')
def rotten_chunk(drive: Recording, folder: Path) -> Path:
    """An MCAP with 3000 bytes of noise in its middle: within one cloud."""
    bag = drive.write(folder / 'bag')
    file = _only(bag, '.mcap')
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 3000] = np.random.default_rng(1).bytes(3000)
    file.write_bytes(bytes(data))
    return bag


@lie(WARNED, MENDED, REFUSED, about=r'hole|absent|gap|no message|holes')
def two_drives(drive: Recording, folder: Path) -> Path:
    """The same drive twice in one bag, the second a quarter of an hour later."""
    later = 900 * 10**9
    again = [
        (t + later, topic, restamped(m, stamp_of(m) + later))
        for t, topic, m in drive.items
        if hasattr(m, 'header')
    ]
    return drive.plus(again).write(folder / 'bag')


def _split(drive: Recording, folder: Path) -> Path:
    """A bag of two files with common metadata, each half of the drive."""
    until = (drive.start + drive.end) // 2
    halves = [
        drive.with_items(item for item in drive.items if (item[0] < until) is first)
        for first in (True, False)
    ]
    parts = [half.write(folder.parent / f'part_{n}') for n, half in enumerate(halves)]
    folder.mkdir()
    names = []
    for number, part in enumerate(parts):
        names.append(f'bag_{number}.mcap')
        shutil.move(_only(part, '.mcap'), folder / names[-1])
    whole = drive.write(folder.parent / 'whole')
    text = (whole / 'metadata.yaml').read_text()
    text = text.replace('- whole.mcap', ''.join(f'- {name}\n  ' for name in names).rstrip())
    (folder / 'metadata.yaml').write_text(text)
    drive.write_settings(folder)
    for part in (*parts, whole):
        shutil.rmtree(part)
    return folder
