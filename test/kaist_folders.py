"""A small KAIST folder that tests write."""

from pathlib import Path

import numpy as np

START = 1_544_676_777_000_000_000
MS = 1_000_000
IDENTITY = '1 0 0 0 1 0 0 0 1'
FLIPPED = '-1 0 0 0 -1 0 0 0 1'


def make_folder(path: Path, scans: int = 4, right: bool = True) -> Path:
    """A KAIST folder: scans at 100 ms, IMU at 10 ms, fixes at 50 ms, all of them out of phase."""
    sensors = path / 'sensor_data'
    sensors.mkdir(parents=True)
    rng = np.random.default_rng(7)
    for name, phase in (('left', 0), ('right', 37))[: 2 if right else 1]:
        stamps = [START + (100 * i + phase) * MS for i in range(scans)]
        folder = sensors / f'VLP_{name}'
        folder.mkdir()
        for stamp in stamps:
            rng.normal(size=(20, 4), scale=9).astype('<f4').tofile(folder / f'{stamp}.bin')
        write_lines(sensors / f'VLP_{name}_stamp.csv', stamps)
    end = 100 * scans
    imu = [
        f'{START + (t + 3) * MS + 11},0,0,0,1,9,9,9,0.1,0.2,0.3,1,2,{t},7,7,7'
        for t in range(0, end, 10)
    ]
    write_lines(sensors / 'xsens_imu.csv', imu)
    states = [4, 5, 1, 0]
    fixes = [
        f'{START + (t + 5) * MS},36.5,127.25,1,2,{50 + t},{states[t // 50 % 4]},12,'
        '1.0,0.02,0.03,0.04,1,0.0,1,1,A'
        for t in range(0, end, 50)
    ]
    write_lines(sensors / 'vrs_gps.csv', fixes)
    write_lines(
        path / 'global_pose.csv',
        [f'{START + t * MS},1,0,0,{t},0,1,0,5,0,0,1,6' for t in range(0, end, 10)],
    )
    (path / 'calibration').mkdir()
    write_calibration(path, 'LeftVLP', FLIPPED, '-1.5 0.5 1.75')
    write_calibration(path, 'RightVLP', IDENTITY, '-1.5 -0.5 1.75')
    write_calibration(path, 'IMU', IDENTITY, '-0.07 0 1.7')
    write_calibration(path, 'VRS', IDENTITY, '-0.32 0 1.7')
    return path


def write_lines(path: Path, lines: list) -> None:
    path.write_text(''.join(f'{line}\n' for line in lines))


def write_calibration(path: Path, name: str, rotation: str, translation: str) -> None:
    text = f'Calibrated by hand\nRPY: 0 0 0\nR: {rotation}\nT: {translation}\n'
    (path / 'calibration' / f'Vehicle2{name}.txt').write_text(text)
