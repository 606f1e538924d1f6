"""Hostile messages among those of a drive: all come to nothing."""

import numpy as np
import pytest
from fuzz import NOISE, TYPES, apart, write_bag
from lies.hostile import KINDS, mixed, valid
from lies.recording import FIX, IMU, LEFT, RIGHT, STORE

from incremental_mapper.datasets.message_conversion import (
    fix_from_message,
    imu_from_message,
    scan_from_message,
)
from incremental_mapper.errors import MeasurementError

MAKERS = {
    LEFT: lambda message: scan_from_message(message, 'left'),
    RIGHT: lambda message: scan_from_message(message, 'right'),
    IMU: imu_from_message,
    FIX: fix_from_message,
}


def numbers(measurement):
    for name in ('points', 'gyro', 'acceleration'):
        if hasattr(measurement, name):
            yield getattr(measurement, name)
    if hasattr(measurement, 'latitude'):
        yield np.array([measurement.latitude, measurement.longitude])


@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_conversion_takes_every_kind_for_what_it_is(recording):
    seen = set()
    for sent in mixed(recording, 6000, seed=5):
        if sent.topic not in MAKERS:
            continue
        seen.add((sent.topic, sent.kind))
        try:
            message = STORE.deserialize_cdr(sent.data, TYPES[sent.topic])
        # Of data that are no message the library raises what it likes; the readers know.
        except Exception:
            assert sent.kind.startswith('raw')
            continue
        try:
            measurement = MAKERS[sent.topic](message)
        except MeasurementError as error:
            assert sent.kind and error.reason
        else:
            assert all(np.isfinite(values).all() for values in numbers(measurement))
    every = {(topic, kind) for topic, kinds in KINDS.items() for kind in kinds}
    assert len(every - seen) < len(every) / 20


@pytest.mark.parametrize('seed', [1, 2])
def test_map_is_that_of_the_drive_alone(recording, map_light, tmp_path, seed):
    among = list(mixed(recording, 400, seed))
    bags = [
        write_bag(sent, recording, tmp_path / name)
        for name, sent in (('alone', valid(recording)), ('among', among))
    ]
    runs = [map_light(bag, out=tmp_path / f'map_{bag.name}', strategy='base') for bag in bags]
    assert runs[0].status == 0
    assert 'Traceback' not in runs[1].err
    for sensor in ('left', 'right', 'gnss'):
        missed = {*runs[0].used(sensor)} - {*runs[1].used(sensor)}
        assert len(missed) <= 1, sensor
    rms, _, count = apart(*(run.folder / 'trajectory.tum' for run in runs))
    assert count > 20 and rms < NOISE
