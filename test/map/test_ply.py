"""The file of a map: its columns, written and read in pieces, and what is no map."""

import numpy as np
import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.map.ply import MapCloud, MapFile, ScanTable, write_ply, write_scans
from incremental_mapper.measurements import NANOSECONDS

START = 1_544_590_798_000_000_000


def cloud(count, columns):
    points = np.arange(count * columns, dtype=np.float32).reshape(count, columns)
    scans = ScanTable(
        stamps=START + np.arange(3, dtype=np.int64) * NANOSECONDS // 20,
        lidars=np.array([1, 0, 1], dtype=np.uint8),
        windows=np.array([4, 4, 5], dtype=np.int32),
        names=('left', 'right one'),
    )
    return MapCloud(points, (np.arange(count) % 3).astype(np.int32), scans)


def write(folder, made):
    write_ply(folder / 'map.ply', made)
    write_scans(folder / 'map_scans.ply', made)
    return MapFile(folder / 'map.ply')


@pytest.mark.parametrize('columns', [3, 4])
def test_every_point_has_the_time_lidar_and_window_of_its_scan(columns, tmp_path):
    made = cloud(7, columns)
    file = write(tmp_path, made)
    assert file.count == 7 and file.lidars == ('left', 'right one')
    pieces = list(file.records(size=3))
    assert [len(piece) for piece in pieces] == [3, 3, 1]
    records = np.concatenate(pieces)
    names = ('x', 'y', 'z', 'intensity')[:columns]
    assert records.dtype.names == (*names, 'time', 'lidar', 'window')
    for index, name in enumerate(names):
        assert np.array_equal(records[name], made.points[:, index])
    stamps = np.rint((records['time'] - START / NANOSECONDS) * 20).astype(int)
    assert stamps.tolist() == [0, 1, 2, 0, 1, 2, 0]
    assert records['lidar'].tolist() == [1, 0, 1, 1, 0, 1, 1]
    assert records['window'].tolist() == [4, 4, 5, 4, 4, 5, 4]


@pytest.mark.parametrize('columns', [3, 4])
def test_points_are_floats_alone_as_they_were_before(columns, tmp_path):
    """Readers that know nothing else took them, and runs of before have no scans."""
    made = cloud(5, columns)
    write_ply(tmp_path / 'map.ply', made)
    head, _, body = (tmp_path / 'map.ply').read_bytes().partition(b'end_header\n')
    names = [line.split()[-1].decode() for line in head.splitlines() if b'property' in line]
    assert names == ['x', 'y', 'z', 'intensity'][:columns]
    assert body == made.points.astype('<f4').tobytes()
    file = MapFile(tmp_path / 'map.ply')
    assert file.lidars == () and file.dtype.names == tuple(names)


def test_a_map_without_scans_has_none(tmp_path):
    empty = write(tmp_path, MapCloud.bare(np.zeros((0, 3), dtype=np.float32)))
    assert empty.count == 0 and list(empty.records()) == []
    bare = write(tmp_path, MapCloud.bare(np.ones((4, 3), dtype=np.float32)))
    assert bare.dtype.names == ('x', 'y', 'z') and len(next(bare.records())) == 4


def test_what_is_no_map_is_named(tmp_path):
    write(tmp_path, cloud(7, 4))
    path, scans = tmp_path / 'map.ply', tmp_path / 'map_scans.ply'
    whole, numbers = path.read_bytes(), scans.read_bytes()
    flat, unknown = whole.replace(b'float z', b'float w'), whole.replace(b'float z', b'double z')
    for content in (whole[:-1], whole + b'1', whole[:40], b'', flat, unknown):
        path.write_bytes(content)
        with pytest.raises(InputError, match='damaged'):
            _ = MapFile(path).count
    path.write_bytes(whole)
    fewer = numbers.replace(b'point 7', b'point 6')
    for content in (numbers[:-1], numbers[:40], b'', fewer, numbers[:-4] + b'\x63\0\0\0'):
        scans.write_bytes(content)
        with pytest.raises(InputError, match=r'map_scans.ply: is damaged'):
            list(MapFile(path).records())
