"""Of several GNSS receivers in a bag the one is taken whose fixes are of use, and surest."""

from dataclasses import replace

import numpy as np
import pytest
from bag_files import CLOUD, FIX, MS, START, STORES, TEXT, message
from rosbags.rosbag2 import StoragePlugin, Writer

from incremental_mapper.datasets.open import open_source

STORE = STORES[2]
DIGEST = 'RIHS01_d9b329e940d423965fbb2cd18cfb49ae6b81f65d47f44f5d1f025d0149b3ef6c'
"""Of the definition below."""


def fix(stamp, sigma=0.05, status=0):
    made = message(FIX, stamp)
    return replace(
        made,
        status=replace(made.status, status=status),
        position_covariance=np.diag([sigma**2] * 3).ravel(),
        position_covariance_type=2,
    )


def write(path, **receivers):
    """A bag with clouds and, for each receiver, so many fixes and what they are like."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:

        def add(topic, kind, made):
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number, one in enumerate(made):
                stamp = START + number * 100 * MS
                writer.write(connection, stamp, STORE.serialize_cdr(one, kind))

        add('/points', CLOUD, [message(CLOUD, START + i * 100 * MS) for i in range(20)])
        for name, (count, like) in receivers.items():
            stamps = [START + i * 100 * MS for i in range(count)]
            add(f'/{name}/fix', FIX, [fix(stamp, **like) for stamp in stamps])
    return path


def told(source):
    return [found.text for found in source.info.findings if found.rule == 'gnss_topic']


@pytest.mark.parametrize(
    ('like', 'reason'),
    [({'status': -1}, 'has no usable fix at first'), ({'sigma': 3.0}, 'a deviation of 3 m')],
)
def test_the_better_one_is_taken_though_it_has_fewer_messages(like, reason, tmp_path):
    source = open_source(write(tmp_path / 'bag', a=(40, like), b=(8, {})))
    assert source.info.settings['gnss']['topic'] == '/b/fix'
    (text,) = told(source)
    assert reason in text


def test_of_equals_the_one_with_the_most_messages_is_taken(tmp_path):
    source = open_source(write(tmp_path / 'bag', a=(8, {}), b=(40, {'sigma': 0.08})))
    assert source.info.settings['gnss']['topic'] == '/b/fix'
    assert not told(source)


def test_one_that_is_named_is_taken_whatever_it_is(tmp_path):
    bag = write(tmp_path / 'bag', a=(40, {'status': -1}), b=(8, {}))
    source = open_source(bag, {'gnss': {'topic': '/a/fix'}})
    assert source.info.settings['gnss']['topic'] == '/a/fix'
    assert not told(source)


def test_sentences_of_a_receiver_are_named_with_what_converts_them(tmp_path):
    kind = 'nmea_msgs/msg/Sentence'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        clouds = writer.add_connection('/points', CLOUD, typestore=STORE)
        writer.write(clouds, START, STORE.serialize_cdr(message(CLOUD, START), CLOUD))
        nmea = writer.add_connection('/nmea', kind, msgdef='string data\n', rihs01=DIGEST)
        writer.write(nmea, START, STORE.serialize_cdr(message(TEXT, START), TEXT))
    source = open_source(tmp_path / 'bag')
    (found,) = [found for found in source.info.findings if found.rule == 'vendor_message']
    assert found.sensor == 'gnss' and 'nmea_navsat_driver' in found.remedy
