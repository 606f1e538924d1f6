"""A recording whose IMU speaks in g is mapped as if it did not."""

import numpy as np
from drive_edits import lines, rewrite, table

ACCELERATIONS = slice(11, 14)


def test_accelerations_in_g_are_converted_and_said(map_light, light_drive, light_copy, tmp_path):
    path = table(light_copy, 'xsens_imu')
    rows = [line.split(',') for line in lines(path)]
    for row in rows:
        row[ACCELERATIONS] = [f'{float(value) / 9.80665:.12f}' for value in row[ACCELERATIONS]]
    rewrite(path, [','.join(row) for row in rows])
    good = map_light(light_drive, out=tmp_path / 'good')
    mended = map_light(light_copy, out=tmp_path / 'mended')
    assert [found['rule'] for found in mended.stats['warnings']] == ['imu_in_g']
    assert mended.stats['settings']['imu']['acceleration_scale'] == 9.80665
    shift = good.trajectory.positions - mended.trajectory.positions
    assert np.abs(shift).max() < 0.01
