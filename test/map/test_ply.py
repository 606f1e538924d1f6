"""The file of a map: its columns, written and read in pieces, and what is no map."""

import numpy as np
import pytest

from incremental_mapper.errors import InputError
from incremental_mapper.map.ply import MapCloud, MapFile, ScanTable, write_ply
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


@pytest.mark.parametrize('columns', [3, 4])
def test_every_point_has_the_time_lidar_and_window_of_its_scan(columns, tmp_path):
    made = cloud(7, columns)
    write_ply(tmp_path / 'map.ply', made)
    file = MapFile(tmp_path / 'map.ply')
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
def test_points_without_scans_are_floats_alone_as_files_were_before(columns, tmp_path):
    points = np.arange(5 * columns, dtype=np.float32).reshape(5, columns)
    write_ply(tmp_path / 'map.ply', MapCloud.bare(points))
    head, _, body = (tmp_path / 'map.ply').read_bytes().partition(b'end_header\n')
    names = [line.split()[-1].decode() for line in head.splitlines() if b'property' in line]
    assert names == ['x', 'y', 'z', 'intensity'][:columns]
    assert body == points.astype('<f4').tobytes()
    assert MapFile(tmp_path / 'map.ply').lidars == ()


def test_another_library_reads_the_points(tmp_path):
    trimesh = pytest.importorskip('trimesh', reason='trimesh is not installed (extra "test")')
    made = cloud(7, 4)
    write_ply(tmp_path / 'map.ply', made)
    read = trimesh.load(tmp_path / 'map.ply', process=False)
    assert np.array_equal(np.asarray(read.vertices, dtype=np.float32), made.points[:, :3])
    data = read.metadata['_ply_raw']['vertex']['data']
    assert data['window'].ravel().tolist() == [4, 4, 5, 4, 4, 5, 4]
    assert data['time'].ravel() == pytest.approx(np.concatenate([*made.records()])['time'], abs=0)


def test_what_is_no_map_is_named(tmp_path):
    path = tmp_path / 'map.ply'
    write_ply(path, cloud(7, 4))
    whole = path.read_bytes()
    wrong = (
        whole.replace(b'property uchar', b'property huge'),
        whole.replace(b'float z', b'float w'),
    )
    for content in (whole[:-1], whole + b'1', whole[:40], b'', *wrong):
        path.write_bytes(content)
        with pytest.raises(InputError, match='damaged'):
            _ = MapFile(path).count
