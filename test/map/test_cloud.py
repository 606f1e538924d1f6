"""The accumulated map, and the stores that its scans are kept in."""

import gc
import os
import resource
import tempfile
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import incremental_mapper.map.cloud as cloud
from incremental_mapper.errors import OutputError
from incremental_mapper.geometry import pose_matrix, transform_points
from incremental_mapper.map.store import MemoryStore, SpillingStore, large_files, make_store
from incremental_mapper.settings import make_config


def voxels(points, size):
    return {
        tuple(cell) for cell in np.floor(np.asarray(points, dtype=np.float64) / size).astype(int)
    }


def mapped(scans, size, **limits):
    numbered = [(points, pose, number) for number, (points, pose) in enumerate(scans)]
    return cloud.accumulate(numbered, size, **limits)[0]


def scattered(count, spread, seed, size=0.5):
    """Points that keep clear of the borders of their voxels, whatever rounding does."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(-round(spread / size), round(spread / size), size=(count, 3))
    return ((cells + rng.uniform(0.05, 0.95, size=(count, 3))) * size).astype(np.float32)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2000), st.integers(0, 10_000), st.sampled_from([100, 700, 10_000]))
def test_map_has_one_point_in_every_voxel_that_was_seen(count, seed, chunk):
    points = scattered(count, 300.0, seed)
    pieces = [(part, np.eye(4)) for part in np.array_split(points, 7)]
    before, cloud.CHUNK = cloud.CHUNK, chunk
    try:
        made = mapped(pieces, 0.5)
    finally:
        cloud.CHUNK = before
    assert made.dtype == np.float32 and made.shape[1:] == (3,)
    assert len(made) == len(voxels(made, 0.5))
    assert voxels(made, 0.5) == voxels(points, 0.5)


def test_points_of_a_voxel_are_averaged():
    points = np.array([[1.1, 0.1, 0.1], [1.3, 0.3, 0.1], [5.1, 0.1, 0.1]], dtype=np.float32)
    made = mapped([(points, np.eye(4))], 0.5)
    assert made[np.argsort(made[:, 0])] == pytest.approx(
        np.array([[1.2, 0.2, 0.1], [5.1, 0.1, 0.1]]), abs=1e-6
    )


def test_scans_are_placed_by_their_poses():
    points = scattered(500, 20.0, 1)
    pose = pose_matrix([2000.0, -3000.0, 10.0, 0.0, 0.0, np.sin(0.4), np.cos(0.4)])
    made = mapped([(points, pose)], 0.01)
    wanted = transform_points(pose, points.astype(np.float64))
    order = [np.lexsort(np.round(table, 2).T) for table in (made, wanted)]
    assert made[order[0]] == pytest.approx(wanted[order[1]], abs=2e-3)


@pytest.mark.parametrize('chunk', [50, 10_000])
def test_map_has_the_intensities_that_are_known_and_no_others(chunk, monkeypatch):
    monkeypatch.setattr(cloud, 'CHUNK', chunk)
    rng = np.random.default_rng(2)
    dark, bright = scattered(400, 20.0, 3), scattered(400, 20.0, 4) + np.float32([60.0, 0, 0])
    lit = np.column_stack([bright, rng.uniform(1.0, 200.0, 400).astype(np.float32)])
    scans = [(dark[:200], np.eye(4)), (lit, np.eye(4)), (dark[200:], np.eye(4))]
    made = mapped(scans, 0.5)
    plain = mapped([(points[:, :3], pose) for points, pose in scans], 0.5)
    assert made.shape[1] == 4 and np.isfinite(made).all()
    assert np.array_equal(made[:, :3], plain)
    assert ((made[:, 3] > 0.0) == (made[:, 0] > 30.0)).all()
    assert made[made[:, 3] > 0.0, 3].min() >= 1.0 and made[:, 3].max() <= 200.0


@settings(deadline=None, max_examples=15)
@given(st.integers(1, 9), st.integers(0, 10_000), st.sampled_from([60, 400, 10_000]))
def test_a_voxel_knows_the_scan_that_saw_it_first(count, seed, chunk):
    pieces = np.array_split(scattered(1000, 8.0, seed), count)
    first = {}
    for number, piece in enumerate(pieces):
        for cell in sorted(voxels(piece, 0.5)):
            first.setdefault(cell, 7 * number)
    before, cloud.CHUNK = cloud.CHUNK, chunk
    try:
        made, marks = cloud.accumulate(
            [(piece, np.eye(4), 7 * number) for number, piece in enumerate(pieces)], 0.5
        )
    finally:
        cloud.CHUNK = before
    cells = np.floor(made.astype(np.float64) / 0.5).astype(int)
    assert {tuple(cell): mark for cell, mark in zip(cells, marks, strict=True)} == first


def test_points_out_of_range_and_not_finite_are_left_out():
    points = np.array([[3.0, 4.0, 0.0], [30.0, 40.0, 0.0], [np.nan, 1.0, 1.0]], dtype=np.float32)
    far = pose_matrix([500.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    near = mapped([(points, far)], 0.5, max_range=49.9)
    assert near == pytest.approx(np.array([[503.0, 4.0, 0.0]]))
    assert len(mapped([(points, far)], 0.5, max_range=50.1)) == 2
    assert len(mapped([(points, far)], 0.5)) == 2


def test_map_without_scans_is_empty():
    assert mapped([], 0.2).shape == (0, 3)


def store_of(**settings):
    return make_store(make_config({'map': settings}).map)


@pytest.mark.parametrize('kind', ['memory', 'spill', 'disk'])
def test_store_gives_back_what_was_put(kind, tmp_path):
    store = store_of(store=kind, store_folder=str(tmp_path), memory=0.05)
    assert isinstance(store, MemoryStore if kind == 'memory' else SpillingStore)
    clouds = [scattered(count, 20.0, count) for count in (100, 0, 1, 5000)]
    clouds += [np.pad(points, ((0, 0), (0, 1)), constant_values=7.0) for points in clouds]
    stored = [store.put(points) for points in clouds]
    for points, kept in reversed(list(zip(clouds, stored, strict=True))):
        assert kept.nbytes == points.nbytes
        assert np.array_equal(kept.load(), points)
        assert kept.load().shape == points.shape


def open_files():
    return len(list(Path('/proc/self/fd').iterdir()))


def test_disk_store_leaves_nothing_behind(tmp_path):
    gc.collect()  # files of tests before
    store = SpillingStore(tmp_path)
    kept = store.put(scattered(100, 20.0, 0))
    descriptors = open_files()
    del store
    assert kept.load().shape == (100, 3)  # who holds points holds their file
    del kept
    gc.collect()
    assert open_files() == descriptors - 1
    assert list(tmp_path.iterdir()) == []


def test_folder_that_cannot_hold_the_map_is_named(tmp_path):
    with pytest.raises(OutputError, match='nowhere: cannot hold the map'):
        make_store(
            make_config({'map': {'store': 'disk', 'store_folder': str(tmp_path / 'nowhere')}}).map
        )


def test_full_disk_keeps_scans_in_memory_and_then_counts_them(tmp_path):
    scans = [np.full((100, 3), number, dtype=np.float32) for number in range(6)]
    store = SpillingStore(tmp_path, most_in_memory=2400)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, before[1]))
    try:
        kept = [store.put(scan) for scan in scans[:5]]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept.append(store.put(scans[5]))  # there is room again
    for number in (0, 1, 2, 3, 5):
        np.testing.assert_array_equal(kept[number].load(), scans[number])
    assert kept[4].load().shape == (0, 3)
    (finding,) = store.findings
    assert finding.rule == 'store_full' and 'points of 1 scans are left out' in finding.text


@pytest.mark.parametrize('kind', ['spill', 'disk'])
def test_scans_beyond_the_bound_are_in_no_memory(kind, tmp_path):
    store = store_of(store=kind, store_folder=str(tmp_path), memory=1.0)
    scan = np.zeros((10_000, 3), dtype=np.float32)  # 0.12 MB
    tracemalloc.start()
    kept = [store.put(scan.copy()) for _ in range(100)]
    used = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert used < (1.1e6 if kind == 'spill' else 0.1e6)
    assert sum(item.nbytes for item in kept) == 12e6
    assert kept[0].load().shape == kept[99].load().shape == (10_000, 3)


def test_default_store_is_bounded_and_needs_no_file_before_that(monkeypatch, tmp_path):
    monkeypatch.setenv('TMPDIR', str(tmp_path / 'nowhere'))
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'nowhere'))
    store = store_of()
    assert isinstance(store, SpillingStore)
    scan = np.zeros((1_000_000, 3), dtype=np.float32)
    few = [store.put(scan) for _ in range(10)]  # 120 MB, all the same
    assert store.findings == ()
    more = [store.put(scan) for _ in range(2)]
    assert all(item.load().shape == (1_000_000, 3) for item in few + more)
    (finding,) = store.findings  # there is no such folder: they stay in memory, and that is said
    assert finding.rule == 'store_full'


def test_disk_that_fills_up_is_told_of_in_time(tmp_path):
    plenty = store_of(store='disk', store_folder=str(tmp_path))
    few = store_of(store='disk', store_folder=str(tmp_path), reserve=1e9)
    for store in (plenty, few):
        assert store.findings == ()
        store.put(np.zeros((10, 3), dtype=np.float32))
    free = os.statvfs(tmp_path)
    if free.f_bavail * free.f_frsize > 3e9:
        assert plenty.findings == ()
    (finding,) = few.findings
    assert finding.rule == 'disk_low' and str(tmp_path) in finding.text


def test_large_files_go_where_the_system_keeps_them_on_disk(monkeypatch, tmp_path):
    monkeypatch.delenv('TMPDIR', raising=False)
    assert large_files() == Path('/var/tmp')
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    monkeypatch.setattr(tempfile, 'tempdir', None)
    assert large_files() == tmp_path
