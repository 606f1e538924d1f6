"""Sweeps in other units, axes and times, and what stands where there was no return."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lies.clouds import LAYOUT
from lies.lie import Verdict, lie
from lies.recording import (
    LIDARS,
    RIGHT,
    Recording,
    cloud_of,
    points_of,
    stamp_of,
    table,
    times_of,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
TOLD = (MENDED, WARNED, REFUSED)
Array = NDArray[Any]


def _ranges(points: Array) -> Array:
    return np.linalg.norm(points, axis=1, keepdims=True)


def _points(
    name: str,
    text: str,
    change: Callable[[Array], Array],
    *expected: Verdict,
    topics: Any = LIDARS,
    code: str = '<f4',
) -> None:
    def make(drive: Recording, folder: Path) -> Path:
        made = drive.each(topics, lambda m: cloud_of(m, table(change(points_of(m)), code)))
        return made.write(folder / 'bag')

    make.__name__, make.__doc__ = name, f'{text}.'
    lie(*(expected or TOLD), about=LAYOUT + '|distance', drive='turns')(make)


_points('kilometres', 'X, y, z in kilometres', lambda p: p / 1000.0)
_points('inches', 'X, y, z in inches', lambda p: p / 0.0254)
_points('decimetres', 'X, y, z in decimetres', lambda p: p * 10.0)
_points('tenths_of_mm', 'X, y, z in 0.1 mm, int32', lambda p: np.round(p * 1e4), code='<i4')
_points('short_ranges', 'Ranges of both LiDARs 20 per cent too short', lambda p: 0.8 * p)
_points('doubled_z', 'Heights twice as large', lambda p: p * np.float32([1, 1, 2]))
_points('z_down', 'Left-handed clouds: z down', lambda p: p * np.float32([1, 1, -1]))
_points('turned_about', 'Both clouds turned by 180 degrees', lambda p: p * np.float32([-1, -1, 1]))
_points('camera_axes', 'X right, y down, z ahead', lambda p: p[:, [1, 2, 0]] * [-1, -1, 1])
_points('one_mirrored', 'Right cloud mirrored', lambda p: p * np.float32([1, -1, 1]), topics=RIGHT)
_points(
    'spherical',
    'Range, azimuth and elevation in place of x, y, z',
    lambda p: np.hstack(
        [
            _ranges(p),
            np.arctan2(p[:, 1:2], p[:, :1]),
            np.arcsin(p[:, 2:] / np.maximum(_ranges(p), 1e-6)),
        ]
    ),
)
_points(
    'nothing_as_nan_and_zero',
    'NaN and zeros where there was no return',
    lambda p: np.insert(np.insert(p, range(0, len(p), 3), np.nan, 0), range(0, len(p), 4), 0.0, 0),
    SOUND,
)
_points(
    'nothing_as_far',
    'A point at 200 m where there was no return',
    lambda p: np.insert(p, range(0, len(p), 3), [200.0, 0.0, 0.0], 0),
    SOUND,
    *TOLD,
)
_points(
    'nothing_as_shell',
    'A point at 40 m along the beam where there was no return',
    lambda p: np.concatenate([p, 40.0 * p[::3] / np.maximum(_ranges(p[::3]), 1e-6)]),
    SOUND,
    *TOLD,
)


def _times(name: str, text: str, kind: str, times: Callable[[Array, int], Array]) -> None:
    for drive in ('timed', 'turns'):

        def make(recording: Recording, folder: Path) -> Path:
            def change(cloud: Any) -> Any:
                points = points_of(cloud)
                values = times(times_of(points), stamp_of(cloud))
                return cloud_of(cloud, table(points, time=(kind, values)))

            return recording.each(LIDARS, change).write(folder / 'bag')

        make.__name__ = name + ('_turns' if drive == 'turns' else '')
        make.__doc__ = text + ('.' if drive == 'timed' else ', over bends.')
        about = r'time|skew|left|right|clock'
        lie(SOUND, MENDED, WARNED, about=about, drive=drive, factor=2.0)(make)


_times(
    'times_float32', 'Point times of the epoch, single precision', '<f4', lambda t, s: s / 1e9 + t
)
_times('times_tenths', 'Point times in 0.1 ms', '<f4', lambda t, _: 1e4 * t)
_times(
    'times_wrap',
    'Point times in ns of the epoch in 32 bits, which wrap',
    '<u4',
    lambda t, s: (s + np.round(t * 1e9).astype(np.int64)) % 2**32,
)
_times(
    'times_since_first',
    'Point times since the first, stamp of the last',
    '<f4',
    lambda t, _: t - t.min(),
)
_times('times_gps', 'Point times of the epoch by GPS', '<f8', lambda t, s: s / 1e9 + t + 18.0)
_times(
    'times_since_hour',
    'Point times in us since the full hour',
    '<u4',
    lambda t, s: (s // 1000 + np.round(t * 1e6).astype(np.int64)) % 3_600_000_000,
)
