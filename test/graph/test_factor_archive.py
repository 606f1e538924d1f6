"""The archive of factors: a list, whose old part is packed and says the same to the last digit."""

import gtsam
import numpy as np
import pytest
from turning_car import MS, imu_series
from turning_car import settings as car_settings

from incremental_mapper.frontend.imu_preintegration import preintegrate, preintegration_parameters
from incremental_mapper.graph import factor_archive
from incremental_mapper.graph.factor_archive import FactorArchive
from incremental_mapper.graph.factors import (
    Factor,
    FactorKind,
    between_factor,
    closure_factor,
    gnss_factor,
    imu_factor,
)
from incremental_mapper.variables import kind_of, pose_key


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(factor_archive, 'BLOCK', 4)
    monkeypatch.setattr(factor_archive, 'NEWEST', 8)


def made(number):
    """A factor of one of four kinds, made of irrational numbers."""
    rng = np.random.default_rng(number)
    half = rng.normal(size=(6, 6))
    pose = gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), rng.normal(size=3))
    keys, stamps = (pose_key(number), pose_key(number + 1)), (number, number + 1)
    if number % 4 == 0:
        config = car_settings()
        span = preintegrate(
            imu_series(0, 200 * MS),
            0,
            100 * MS,
            preintegration_parameters(config.preintegration, config.imu.matrix()),
            gtsam.imuBias.ConstantBias(rng.normal(size=3), rng.normal(size=3)),
            constant_bias=number % 8 == 0,
        )
        return imu_factor(number, number + 1, span, 'imu', stamps, np.arange(9) + number)
    if number % 4 == 1:
        covariance = half[:3, :3] @ half[:3, :3].T
        return gnss_factor(keys[0], half[0, :3], covariance, half[1, :3], 2.0, 'gnss', number)
    if number % 4 == 2:
        return closure_factor(keys, pose, half @ half.T, 3.0, stamps)
    return between_factor(FactorKind.ODOMETRY, keys, pose, half @ half.T, 'left', stamps)


def values_for(factors):
    values = gtsam.Values()
    rng = np.random.default_rng(7)
    for key in sorted({key for factor in factors for key in factor.keys}):
        kind = kind_of(key)
        if kind == 'x':
            values.insert(key, gtsam.Pose3(gtsam.Rot3.Expmap(rng.normal(size=3)), np.ones(3)))
        elif kind == 'v':
            values.insert(key, rng.normal(size=3))
        else:
            bias = gtsam.imuBias.ConstantBias(rng.normal(size=3), rng.normal(size=3))
            values.insert(key, bias)
    return values


def grown(count):
    archive, plain = FactorArchive(), [made(number) for number in range(count)]
    for factor in plain:
        archive.extend([factor])
    return archive, plain


def told(factor):
    return factor.kind, factor.keys, factor.sensor, factor.stamps, factor.data


def test_old_factors_say_the_same_to_the_last_digit():
    archive, plain = grown(30)
    assert archive[-1] is plain[-1] and archive[0] is not plain[0]  # something is packed
    assert [told(one) for one in archive] == [told(one) for one in plain]
    values = values_for(plain)
    for one, other in zip(archive, plain, strict=True):
        assert one.factor.error(values) == other.factor.error(values)


def test_it_is_a_list_wherever_one_looks():
    archive, plain = grown(30)
    stamps = [one.stamps for one in plain]
    assert len(archive) == 30 and not FactorArchive()
    assert [one.stamps for one in archive[5:25:3]] == stamps[5:25:3]
    assert [one.stamps for one in archive[::-1]] == stamps[::-1]
    assert archive[27:] == plain[27:] and archive[30:] == [] and archive[26:3] == []
    assert [one.stamps for one in reversed(archive)] == stamps[::-1]
    assert [archive[place].stamps for place in (0, 13, 29, -30)] == [
        stamps[place] for place in (0, 13, 29, -30)
    ]
    with pytest.raises(IndexError):
        archive[30]


def test_what_is_unpacked_stays_so_until_more_comes():
    archive, plain = grown(30)
    every = archive.unpacked()
    assert archive.unpacked() is every and archive[0] is every[0] and len(every) == 30
    archive.extend([made(30)])
    assert archive[0] is not every[0] and len(archive) == 31
    assert [one.stamps for one in archive][:30] == [one.stamps for one in plain]


def test_old_factors_can_be_changed():
    archive, plain = grown(30)
    archive[2] = made(50)
    archive.append(made(51))
    archive.insert(0, made(52))
    del archive[1]
    expected = [made(52), plain[1], made(50), *plain[3:], made(51)]
    assert [one.stamps for one in archive] == [one.stamps for one in expected]


def test_a_factor_that_cannot_be_packed_stays_as_it_is():
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 1.0)
    own = Factor(
        FactorKind.ODOMETRY,
        (pose_key(0),),
        gtsam.CustomFactor(noise, [pose_key(0)], lambda *_: np.zeros(1)),
        describe=lambda _: {},
    )
    archive = FactorArchive()
    for number in range(30):
        archive.extend([own if number == 1 else made(number)])
    assert archive[1] is own and archive[5].stamps == made(5).stamps and len(archive) == 30
