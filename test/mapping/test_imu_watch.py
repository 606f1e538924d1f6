"""Evidence on the IMU is gathered as it comes, and absurd samples are none."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from imu_rig import START, rates, samples, velocities

from incremental_mapper.candidates.model import CoreKind, CoreMeasurement
from incremental_mapper.config import Imu
from incremental_mapper.frontend.prepared_scan import PreparedScan
from incremental_mapper.mapping import imu_watch
from incremental_mapper.mapping.imu_intake import ImuIntake
from incremental_mapper.mapping.imu_watch import ImuWatch, _spikes
from incremental_mapper.mapping.watch import Watch
from incremental_mapper.measurements import ImuSample
from incremental_mapper.settings import make_config

NOWHERE = np.zeros((1, 3))
NO_LIMIT = np.full(6, np.inf)


def imu(seconds=10.0, rate=1.0, force=1.0):
    stamps, gyro, acceleration = samples(seconds)
    return [
        ImuSample(int(stamp), 'imu', rate * one, force * other)
        for stamp, one, other in zip(stamps, gyro, acceleration, strict=True)
    ]


def match(seconds):
    """A match of a scan with the one 0.1 s before."""
    middle = np.array([seconds - 0.05])
    turn, shift = 0.1 * rates(middle)[0], 0.1 * velocities(middle)[0]
    core = CoreMeasurement(START + round(seconds * 1e9), 'left', CoreKind.LIDAR)
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(turn), shift)
    return PreparedScan(core, NOWHERE, NOWHERE, core.stamp - 100_000_000, pose)


def watched(stream, seconds=10.0, config=None, contradicted=()):
    """What a watch finds in samples and the matches beside them, in the order of their stamps."""
    watch = ImuWatch(make_config(config or {}))
    watch.contradicted(np.array(contradicted, dtype=np.int64))
    matches = [match(at) for at in np.arange(0.3, seconds - 0.1, 0.1)]
    found = []
    for sample in stream:
        while matches and matches[0].core.stamp < sample.stamp - 500_000_000:
            found += watch.matches([matches.pop(0)])
        found += watch.sample(sample)
    intake = ImuIntake(Imu(), 9.81)
    watch.used([sample for sample in stream if intake.take(sample)])
    return [*found, *watch.matches(matches), *watch.end()]


def test_nothing_is_found_in_a_good_imu():
    assert watched(imu()) == []


@pytest.mark.parametrize(
    ('change', 'rule'), [({'force': 1 / 9.81}, 'imu_in_g'), ({'rate': 180 / np.pi}, 'imu_in_deg')]
)
def test_a_wrong_unit_is_found_and_gone_with_the_setting_that_mends_it(change, rule):
    found = [one for one in watched(imu(**change)) if one.rule == rule]
    assert found
    assert watched(imu(**change), config=found[0].settings) == []


def test_absurd_samples_and_stamps_are_no_evidence():
    stream = imu()
    for index in range(20, len(stream), 40):
        stream[index] = replace(stream[index], acceleration=np.array([1e300, 0.0, 0.0]))
    stream[500] = replace(stream[500], stamp=START + 10**18)
    assert watched(stream) == []


def test_a_quarter_of_hostile_samples_does_not_cost_the_imu():
    rng = np.random.default_rng(0)
    stream = []
    for sample in imu():
        stream.append(sample)
        if rng.random() < 0.33:
            sizes = rng.choice([100.0, 1000.0, 1e5, 1e300], 3) * rng.choice([-1, 1], 3)
            stream.append(replace(sample, stamp=sample.stamp + 1_000_000, gyro=sizes))
    assert watched(stream) == []


def test_an_imu_that_falls_silent_is_told_of():
    found = watched(imu(2.0))
    assert [one.rule for one in found] == ['imu_holes']
    assert '8' in found[0].text


def test_an_imu_that_freezes_is_told_of_as_one_that_falls_silent():
    stream = imu()
    frozen = [replace(stream[200], stamp=sample.stamp) for sample in stream[200:]]
    found = watched([*stream[:200], *frozen])
    assert [one.rule for one in found] == ['imu_holes']


def test_switched_off_it_is_not_looked_at():
    assert watched(imu(force=0.1), config={'imu': {'enabled': False}}) == []


def test_what_switches_the_imu_off_is_asked_of_who_runs_the_mapper():
    watch = Watch(make_config({}))
    stream = [replace(sample, gyro=np.zeros(3)) for sample in imu()]
    for sample in stream:
        watch.measurement(sample)
    watch.prepared([match(at) for at in np.arange(0.3, 9.0, 0.1)])
    assert watch.mend == {'imu': {'enabled': False}}
    assert [found.rule for found in watch.mended()] == ['imu_gyro_frozen']


def knocked(stream, first, count):
    """Samples of which some turn by 20 rad/s, and their stamps."""
    turn = np.array([0.0, 0.0, 20.0])
    hit = [replace(sample, gyro=turn) for sample in stream[first : first + count]]
    return [*stream[:first], *hit, *stream[first + count :]], np.array([s.stamp for s in hit])


def test_a_knock_that_was_left_out_does_not_switch_the_imu_off():
    stream, stamps = knocked(imu(), 400, 20)
    assert [one.rule for one in watched(stream)] == ['imu_disagrees']
    assert watched(stream, contradicted=stamps) == []


def test_an_imu_that_is_wrong_all_along_is_switched_off_beside_a_knock():
    rng = np.random.default_rng(3)
    wrong = [replace(sample, gyro=rng.normal(0.0, 2.0, 3)) for sample in imu(20.0)]
    stream, stamps = knocked(wrong, 400, 20)
    found = watched(stream, 20.0, contradicted=stamps)
    assert 'imu_disagrees' in [one.rule for one in found]
    every = np.array([sample.stamp for sample in stream])
    assert 'imu_disagrees' in [one.rule for one in watched(stream, 20.0, contradicted=every)]


def test_what_is_kept_does_not_grow_with_the_drive(monkeypatch):
    monkeypatch.setattr(imu_watch, 'MOST_SAMPLES', 300)
    monkeypatch.setattr(imu_watch, 'MOST_MATCHES', 30)
    watch = ImuWatch(make_config({}))
    for sample in imu():
        watch.sample(sample)
        assert len(watch._samples) < 600
    for at in np.arange(0.3, 9.0, 0.1):
        watch.matches([match(at)])
        assert len(watch._matches) < 60


def test_stray_stamps_in_the_middle_hide_nothing():
    stream = imu(rate=180.0 / np.pi)
    middle = len(stream) // 2
    strays = [replace(stream[middle], stamp=START - 10**17 + number) for number in range(40)]
    found = watched([*stream[:middle], *strays, *stream[middle:]])
    assert {one.rule for one in found} == {one.rule for one in watched(stream)} != set()


def test_one_absurd_sample_is_no_evidence_against_the_imu():
    rng = np.random.default_rng(2)
    rows = np.hstack([rng.normal(0.0, 0.3, (700, 3)), rng.normal(0.0, 1.0, (700, 3))])
    rows[300, 2], rows[400, 3] = 1000.0, 1e5
    assert np.flatnonzero(_spikes(rows, NO_LIMIT)).tolist() == [300, 400]
    # The same in other units, and a turn that is a fifth of the drive.
    assert np.flatnonzero(_spikes(57.3 * rows, NO_LIMIT)).tolist() == [300, 400]
    turn = np.zeros((700, 6))
    turn[100:240, 2] = 0.5
    assert not _spikes(turn, NO_LIMIT).any()


@pytest.mark.parametrize('field', ['gyro', 'acceleration'])
def test_many_absurd_samples_are_no_evidence_against_the_imu(field):
    """Where a tenth of them is absurd, a share of the samples is no measure of what is usual."""
    rng = np.random.default_rng(4)
    stream = imu()
    hit = rng.random(len(stream)) < 0.1
    size = 300.0 if field == 'gyro' else 1e5
    absurd = [
        replace(item, **{field: size * rng.choice([-1.0, 1.0], 3)}) if bad else item
        for item, bad in zip(stream, hit, strict=True)
    ]
    assert watched(absurd) == watched(stream) == []


def two_lidars(late, config=None, seconds=20.0):
    """What is found with a second LiDAR whose stamps are ``late`` s after the first one's."""
    watch = ImuWatch(make_config(config or {'lidars': {'left': {}, 'right': {}}}))
    for sample in imu(seconds):
        watch.sample(sample)
    found = []
    for at in np.arange(0.3, seconds - 0.5, 0.1):
        left = match(at)
        moment = left.core.stamp + round(late * 1e9)
        core = CoreMeasurement(moment, 'right', CoreKind.LIDAR)
        right = replace(left, core=core, previous=moment - 100_000_000)
        found += watch.matches([left, right])
    return [*found, *watch.end()]


@pytest.mark.parametrize('late', [0.2, -0.3])
def test_one_lidar_whose_clock_is_off_is_found_and_gone_with_its_setting(late):
    found = [one for one in two_lidars(late) if one.rule == 'lidar_clock']
    assert found and {one.sensor for one in found} == {'right'}
    settings = found[-1].settings
    offset = settings['lidars']['right']['time_offset']
    assert offset == pytest.approx(-late, abs=0.011)
    rest = two_lidars(late + offset, {'lidars': {'left': {}, 'right': {'time_offset': offset}}})
    assert [one.rule for one in rest if one.rule == 'lidar_clock'] == []


def test_two_lidars_in_time_or_both_late_are_no_matter_of_one():
    assert two_lidars(0.0) == []
    shifted = ImuWatch(make_config({}))
    for sample in imu(20.0):
        shifted.sample(replace(sample, stamp=sample.stamp + 400_000_000))
    found = []
    for at in np.arange(1.0, 19.0, 0.1):
        left = match(at)
        found += shifted.matches([left, replace(left, core=replace(left.core, sensor='right'))])
    found += shifted.end()
    assert {one.rule for one in found} == {'imu_clock'}
