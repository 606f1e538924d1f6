"""Changes to the files of a KAIST folder, and what is left of it; the files of a run."""

import shutil

import numpy as np

from incremental_mapper.datasets.truth import read_truth
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import match_truth

FILES = {
    'trajectory.tum',
    'map.ply',
    'graph.g2o',
    'graph.json',
    'windows.csv',
    'stats.json',
    'files.json',
}
STATE, LATITUDE, LONGITUDE = 6, 1, 2
LATER = 60 * NANOSECONDS


def scans(folder, side='left'):
    return sorted((folder / 'sensor_data' / f'VLP_{side}').glob('*.bin'))


def table(folder, name):
    return folder / 'sensor_data' / f'{name}.csv'


def lines(path):
    return path.read_text().splitlines()


def rewrite(path, rows):
    path.write_text('\n'.join(rows) + '\n')


def stamps(path):
    return [int(line.split(',')[0]) for line in lines(path)]


def keep_stamps(folder, side, wanted):
    """Leave only the scans of a side whose number in the drive is wanted."""
    listing = table(folder, f'VLP_{side}_stamp')
    rewrite(listing, [line for i, line in enumerate(lines(listing)) if wanted(i)])


def worst_offset(run, folder):
    """Largest horizontal distance to the truth, without any alignment but the first position."""
    estimate, truth = match_truth(run.trajectory, read_truth(folder / 'global_pose.csv'))
    shift = estimate.positions[:, :2] - truth.positions[:, :2]
    return np.linalg.norm(shift - np.median(shift, axis=0), axis=1).max()


def cut_drive(folder, seconds, every=1):
    """Keep the first ``seconds`` of a KAIST folder, and of its scans only some points."""
    data = folder / 'sensor_data'
    tables = [data / f'{name}.csv' for name in ('xsens_imu', 'vrs_gps')]
    tables += [data / f'VLP_{side}_stamp.csv' for side in ('left', 'right')]
    first = min(int(path.stem) for path in data.glob('VLP_*/*.bin'))
    end = first + round(seconds * NANOSECONDS)
    for table in tables:
        lines = table.read_text().splitlines(keepends=True)
        table.write_text(''.join(line for line in lines if int(line.split(',')[0]) < end))
    for path in data.glob('VLP_*/*.bin'):
        if int(path.stem) >= end:
            path.unlink()
        else:
            np.fromfile(path, dtype='<f4').reshape(-1, 4)[::every].tofile(path)


def driven_later(folder, out, by=LATER):
    """The same drive again, a minute later, or so many nanoseconds."""
    shutil.copytree(folder, out)
    for name in ('xsens_imu', 'vrs_gps', 'VLP_left_stamp', 'VLP_right_stamp'):
        path = table(out, name)
        rows = [line.split(',') for line in path.read_text().splitlines()]
        path.write_text(''.join(f'{",".join([str(int(s) + by), *r])}\n' for s, *r in rows))
    for side in ('left', 'right'):
        for path in scans(out, side):
            path.rename(path.with_name(f'{int(path.stem) + by}.bin'))
    (out / 'global_pose.csv').unlink()
    return out
