"""Of several IMUs in a bag the sound one is taken."""

import pytest
from bag_files import CLOUD, IMU, MS, START, STORES, message
from imu_rig import samples
from rosbags.rosbag2 import StoragePlugin, Writer

from incremental_mapper.datasets.open import open_source

STORE = STORES[2]


def imu(stamp, gyro, force):
    made = message(IMU, stamp)
    vector = STORE.types['geometry_msgs/msg/Vector3']
    made.__dict__.update(
        angular_velocity=vector(*map(float, gyro)), linear_acceleration=vector(*map(float, force))
    )
    return made


def write(path, **changes):
    """A bag with an IMU for each change of rates and forces, as many messages as it leaves."""
    _, gyro, force = samples(3.2)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def add(topic, kind, made):
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for stamp, one in made:
                writer.write(connection, stamp, STORE.serialize_cdr(one, kind))

        stamps = [START + i * 100 * MS for i in range(20)]
        add('/points', CLOUD, [(stamp, message(CLOUD, stamp)) for stamp in stamps])
        for name, (every, change) in changes.items():
            stamps = [START + i * 10 * MS for i in range(len(gyro))][::every]
            rows = [change(*row) for row in zip(gyro[::every], force[::every], strict=True)]
            made = [(stamp, imu(stamp, *row)) for stamp, row in zip(stamps, rows, strict=True)]
            add(f'/{name}/imu', IMU, made)
    return path


def good(gyro, force):
    return gyro, force


UNSOUND = {
    'repeats one sample': lambda gyro, force: (0 * gyro, 0 * force),
    'has one angular rate only': lambda gyro, force: (0 * gyro, force),
    'has no gravity': lambda gyro, force: (gyro, 0.2 * (force - (0, 0, 9.81))),
}


@pytest.mark.parametrize('reason', UNSOUND)
def test_the_sound_one_is_taken_though_it_has_fewer_messages(reason, tmp_path):
    bag = write(tmp_path / 'bag', first=(1, UNSOUND[reason]), second=(4, good))
    source = open_source(bag)
    assert source.info.settings['imu']['topic'] == '/second/imu'
    told = [found for found in source.info.findings if found.rule == 'imu_topic']
    assert len(told) == 1
    assert reason in told[0].text


def test_of_sound_ones_the_one_with_the_most_messages_is_taken(tmp_path):
    def in_g(gyro, force):
        return gyro, force / 9.80665

    source = open_source(write(tmp_path / 'bag', first=(4, good), second=(1, in_g)))
    assert source.info.settings['imu']['topic'] == '/second/imu'
    assert not [found for found in source.info.findings if found.rule == 'imu_topic']


def test_one_that_is_named_or_alone_is_taken_whatever_it_is(tmp_path):
    dead = UNSOUND['repeats one sample']
    alone = open_source(write(tmp_path / 'one', first=(1, dead)))
    assert alone.info.settings['imu']['topic'] == '/first/imu'
    both = write(tmp_path / 'two', first=(1, dead), second=(4, good))
    named = open_source(both, {'imu': {'topic': '/first/imu'}})
    assert named.info.counts['imu'] == 320
