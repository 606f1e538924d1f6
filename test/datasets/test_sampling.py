"""A sample of an input is bounded, spread over it, and tells the times of all messages."""

from contextlib import closing

import numpy as np
import pytest
from bag_files import CLOUD, FIX, IMU, MS, START, write_bag, write_ros1
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin

from incremental_mapper.datasets.bag_files import open_bag
from incremental_mapper.datasets.open import open_source
from incremental_mapper.datasets.record_times import record_times
from incremental_mapper.datasets.sampling import SamplePlan, SensorKind, spans, spread
from incremental_mapper.measurements import NANOSECONDS, LidarScan

SECONDS = st.floats(0.001, 0.5)
PLANS = st.builds(SamplePlan, first=st.floats(0.1, 3.0), blocks=st.integers(1, 20), seconds=SECONDS)
LONG = [('/points', CLOUD, 0, 1000, 600), ('/imu', IMU, 3, 250, 2400), ('/fix', FIX, 5, 5000, 120)]
"""Ten minutes."""


@given(PLANS, st.integers(0, 700 * NANOSECONDS), st.booleans())
def test_spans_are_in_order_and_inside(plan, length, anchored):
    anchors = np.arange(START, START + length, 3 * NANOSECONDS) if anchored else None
    found = spans(START, START + length, plan, anchors)
    assert found[0][0] == START
    assert found[-1][1] <= START + length + 1
    bounds = np.array(found)
    assert (bounds[:, 0] < bounds[:, 1]).all()
    assert (bounds[1:, 0] >= bounds[:-1, 0]).all()
    read = (bounds[:, 1] - bounds[:, 0]).sum() / NANOSECONDS
    assert read <= plan.first + plan.blocks * (plan.seconds + 1e-8) + 1e-8


def test_a_block_begins_before_a_rare_message():
    anchors = START + np.arange(0, 600, 1, dtype=np.int64) * NANOSECONDS + 500 * MS
    found = spans(START, START + 600 * NANOSECONDS, SamplePlan(), anchors)
    held = [((anchors >= start) & (anchors < stop)).any() for start, stop in found]
    assert all(held[:-1])


def test_spread_takes_both_ends():
    assert spread(np.arange(1000), 3) == [0, 499, 999]
    assert spread(np.arange(2), 3) == [0, 1]


@pytest.mark.parametrize('plugin', [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_times_of_recording_come_from_the_index(tmp_path, plugin):
    assert_times_are_those_read(write_bag(tmp_path / 'bag', plugin=plugin))


def test_times_of_recording_of_a_ros1_bag(tmp_path):
    assert_times_are_those_read(write_ros1(tmp_path / 'a.bag'))


def assert_times_are_those_read(path):
    with closing(open_bag(path)) as reader:
        found = record_times(reader, {'/imu', '/fix', '/none'})
        assert set(found) == {'/imu', '/fix'}
        for topic, times in found.items():
            connections = [c for c in reader.connections if c.topic == topic]
            read = [time for _, time, _ in reader.messages(connections=connections)]
            assert times.tolist() == read


def test_a_long_bag_is_not_read_whole(tmp_path):
    source = open_source(write_bag(tmp_path / 'bag', LONG))
    plan = SamplePlan(fixes=20)
    cloud, imu, gnss = source.sample(plan)
    assert [sample.kind for sample in (cloud, imu, gnss)] == ['lidar', 'imu', 'gnss']
    assert [len(sample.recorded) for sample in (cloud, imu, gnss)] == [600, 2400, 120]
    assert 0 < len(imu.stamps) < 60
    assert len(np.unique(imu.blocks)) >= plan.blocks
    assert imu.stamps[-1] - imu.stamps[0] > 580 * NANOSECONDS
    # Each fix is looked at once, in a block or by itself.
    assert plan.fixes <= len(gnss.stamps) <= plan.fixes + plan.blocks + 1
    assert len(set(gnss.stamps.tolist())) == len(gnss.stamps)
    assert cloud.fields == ('x', 'y', 'z')
    assert cloud.rate == pytest.approx(1.0)


def test_clouds_beyond_the_first_of_a_block_count_by_their_stamps(light_bag):
    left = next(s for s in open_source(light_bag).sample(SamplePlan()) if s.sensor == 'left')
    everything = [
        item.stamp for item in open_source(light_bag).measurements() if item.sensor == 'left'
    ]
    assert left.stamps.tolist() == everything
    assert [item.stamp for item in left.measurements] == everything[: SamplePlan().most]


def test_a_folder_is_sampled_as_its_bag_is(light_drive, light_bag):
    of_folder = open_source(light_drive).sample(SamplePlan())
    of_bag = open_source(light_bag).sample(SamplePlan())
    for ours, theirs in zip(of_folder, of_bag, strict=True):
        assert (ours.sensor, ours.kind, ours.count) == (theirs.sensor, theirs.kind, theirs.count)
        assert ours.stamps.tolist() == theirs.stamps.tolist()
        assert (ours.logged, theirs.logged) == (False, True)
        assert len(ours.measurements) == len(theirs.measurements)
        if ours.kind is SensorKind.LIDAR:
            assert all(isinstance(item, LidarScan) for item in ours.measurements)


def test_time_offsets_count(light_bag):
    plain = {s.sensor: s for s in open_source(light_bag).sample(SamplePlan())}
    moved = {
        s.sensor: s
        for s in open_source(light_bag, {'imu': {'time_offset': 0.25}}).sample(SamplePlan())
    }
    assert (moved['imu'].stamps - plain['imu'].stamps == 250 * MS).all()
    assert (moved['imu'].received == plain['imu'].received).all()


def test_scans_of_some_spans(light_drive, light_bag):
    for path in (light_drive, light_bag):
        source = open_source(path)
        every = [item.stamp for item in source.measurements() if item.sensor == 'left']
        bounds = [(every[10], every[12]), (every[3], every[4] + 1)]
        found = [(number, scan.stamp) for number, scan in source.scans('left', bounds)]
        assert found == [(0, every[10]), (0, every[11]), (1, every[3]), (1, every[4])]
