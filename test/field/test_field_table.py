"""The table of recordings that lie: what its verdicts mean, and a few rows of it."""

import re

import pytest
from field import CRASH, FALSE, FINE, NOT_MENDED, SILENT, Outcome, judge, run_map
from lies.lie import LIES, Lie, Verdict

SOME = (
    'in_g_and_degrees',
    'wrong_topic',
    'equal_extrinsics',
    'wrong_endianness',
    'blind_lidar',
)


def lie(*expected, about='imu'):
    return Lie('name', 'situation', lambda drive, folder: folder, expected, about, '', 1.5, 0.6, ())


def outcome(ate=0.05, warnings=(), status=0, printed='', lean=0.2, points=1000):
    found = [
        {'rule': rule, 'severity': severity, 'sensor': sensor, 'text': '', 'remedy': ''}
        for rule, severity, sensor in warnings
    ]
    stats = {'warnings': found, 'map_points': points, 'ate_rmse_m': ate}
    mapped = status == 0 or not printed
    return Outcome(status, printed, stats if mapped else None, (ate, lean) if mapped else None, 1.0)


UNHARMED = outcome(warnings=[('known', 'warning', 'left')])
MENDED = [('imu_in_g', 'mended', 'imu')]
WARNED = [('imu_bad', 'warning', 'imu')]
OTHER = [('lost', 'warning', 'left')]
REFUSAL = 'incremental_mapper: INPUT: the imu is upside down'


@pytest.mark.parametrize(
    ('expected', 'found', 'verdict'),
    [
        ((Verdict.MENDED,), outcome(warnings=MENDED), FINE),
        ((Verdict.MENDED,), outcome(), SILENT),
        ((Verdict.MENDED,), outcome(ate=0.3), SILENT),
        ((Verdict.MENDED,), outcome(ate=0.3, warnings=MENDED), NOT_MENDED),
        ((Verdict.MENDED,), outcome(lean=170.0, warnings=MENDED), NOT_MENDED),
        ((Verdict.MENDED,), outcome(points=0, warnings=MENDED), NOT_MENDED),
        ((Verdict.WARNED,), outcome(ate=0.3, warnings=WARNED), FINE),
        ((Verdict.WARNED,), outcome(ate=3.0, warnings=WARNED), NOT_MENDED),
        ((Verdict.WARNED,), outcome(ate=3.0, warnings=OTHER), SILENT),
        ((Verdict.WARNED,), outcome(ate=3.0, status=1, warnings=WARNED), FINE),
        ((Verdict.REFUSED,), outcome(status=1, printed=REFUSAL), FINE),
        ((Verdict.REFUSED,), outcome(status=1, printed='incremental_mapper: no'), SILENT),
        ((Verdict.SOUND,), outcome(status=1, printed=REFUSAL), FALSE),
        ((Verdict.SOUND,), outcome(), FINE),
        ((Verdict.SOUND,), outcome(ate=0.3), SILENT),
        ((Verdict.SOUND,), outcome(warnings=WARNED), FALSE),
        ((Verdict.SOUND,), outcome(warnings=[('known', 'warning', 'left')]), FINE),
        ((Verdict.SOUND, Verdict.WARNED), outcome(warnings=WARNED), FINE),
        ((Verdict.REFUSED,), outcome(status=1, printed=f'Traceback\n{REFUSAL}'), CRASH),
        ((Verdict.REFUSED,), outcome(status=-11, printed=REFUSAL), CRASH),
        ((Verdict.REFUSED,), outcome(status=1, printed='killed'), CRASH),
    ],
)
def test_verdict(expected, found, verdict):
    assert judge(lie(*expected), found, UNHARMED) == verdict


def test_every_generator_says_what_it_does_and_what_is_right():
    assert len(LIES) >= 25
    for item in LIES.values():
        assert item.situation and item.expected
        re.compile(item.about)
        # Whoever is to be told must be told of it.
        assert item.about or item.expected[-1] in (Verdict.SOUND, Verdict.MENDED)


@pytest.fixture(scope='session')
def unharmed(recording, tmp_path_factory):
    folder = tmp_path_factory.mktemp('unharmed')
    return run_map(recording.write(folder / 'bag'), folder / 'out')


@pytest.mark.parametrize('name', SOME)
def test_of_these_users_are_told(name, recording, unharmed, tmp_path):
    source = LIES[name].make(recording, tmp_path)
    found = run_map(source, tmp_path / 'out')
    assert judge(LIES[name], found, unharmed) == FINE, found.printed
