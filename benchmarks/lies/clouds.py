"""Clouds whose layout, units or times are not what they say."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from incremental_mapper.measurements import NANOSECONDS
from lies.lie import Verdict, lie
from lies.recording import (
    LEFT,
    LIDARS,
    RIGHT,
    Item,
    Recording,
    cloud_of,
    in_sectors,
    points_of,
    reframed,
    stamp_of,
    table,
    times_of,
)

MENDED, WARNED, REFUSED, SOUND = Verdict.MENDED, Verdict.WARNED, Verdict.REFUSED, Verdict.SOUND
LAYOUT = r'left|right|point|layout|cloud'


@lie(MENDED, about=LAYOUT)
def wrong_endianness(drive: Recording, folder: Path) -> Path:
    """Little-endian data that is declared big-endian."""
    return drive.each(LIDARS, lambda m: replace(m, is_bigendian=True)).write(folder / 'bag')


@lie(SOUND)
def doubles(drive: Recording, folder: Path) -> Path:
    """X, y, z as float64, rightly declared."""
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m), '<f8'))).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=LAYOUT)
def int16_millimetres(drive: Recording, folder: Path) -> Path:
    """X, y, z as int16 in millimetres."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        near = points[(np.abs(points) < 32.0).all(axis=1)]
        return cloud_of(cloud, table(np.round(near * 1000.0), '<i2'))

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=LAYOUT, drive='curve')
def centimetres(drive: Recording, folder: Path) -> Path:
    """X, y, z in centimetres."""
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) * 100.0))).write(
        folder / 'bag'
    )


@lie(SOUND)
def padded_rows(drive: Recording, folder: Path) -> Path:
    """Organised clouds whose rows are padded."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        height, pad = 8, 20
        width = len(points) // height
        rows = table(points[: width * height]).tobytes()
        size = width * 12
        data = b''.join(rows[i * size : (i + 1) * size] + b'\xff' * pad for i in range(height))
        return cloud_of(
            cloud,
            table(points[:0]),
            height=height,
            width=width,
            row_step=size + pad,
            data=np.frombuffer(data, dtype=np.uint8),
        )

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(SOUND)
def half_nan(drive: Recording, folder: Path) -> Path:
    """Half of the points are NaN."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        spread = np.full((2 * len(points), 3), np.nan, dtype=np.float32)
        spread[::2] = points
        return cloud_of(cloud, table(spread), is_dense=False)

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(SOUND)
def third_zero(drive: Recording, folder: Path) -> Path:
    """Points without return at 0, 0, 0, a third of all."""

    def change(cloud: Any) -> Any:
        points = np.zeros((len(points_of(cloud)) * 3 // 2, 3), dtype=np.float32)
        points[: len(points_of(cloud))] = points_of(cloud)
        return cloud_of(cloud, table(points))

    return drive.each(LIDARS, change).write(folder / 'bag')


def _timed(drive: Recording, kind: str, times: Any, name: str = 'time') -> Recording:
    """With times of the points: ``times`` of the seconds and the stamp."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        values = times(times_of(points), stamp_of(cloud))
        return cloud_of(cloud, table(points, **{name: (kind, values)}))

    return drive.each(LIDARS, change)


@lie(SOUND, drive='timed', factor=2.0)
def times_ns(drive: Recording, folder: Path) -> Path:
    """Point times in ns from the first point."""
    made = _timed(drive, '<u4', lambda t, _: np.round((t - t.min()) * 1e9), 't')
    # The stamp is that of the first point then.
    return made.shifted(LIDARS, -0.1).write(folder / 'bag')


@lie(SOUND, drive='timed')
def times_us(drive: Recording, folder: Path) -> Path:
    """Point times in us before the stamp."""
    return _timed(drive, '<f4', lambda t, _: t * 1e6).write(folder / 'bag')


@lie(SOUND, drive='timed')
def times_absolute(drive: Recording, folder: Path) -> Path:
    """Point times of the epoch, in seconds."""
    made = _timed(drive, '<f8', lambda t, stamp: stamp / NANOSECONDS + t, 'timestamp')
    return made.write(folder / 'bag')


@lie(
    SOUND,
    MENDED,
    WARNED,
    about=r'time|left|right',
    drive='timed',
)
def times_few_absurd(drive: Recording, folder: Path) -> Path:
    """One point in a hundred has a time of 10^9 s."""

    def absurd(times: Any, _: int) -> Any:
        made = times.copy()
        made[::100] = 1e9
        return made

    return _timed(drive, '<f8', absurd).write(folder / 'bag')


@lie(
    WARNED,
    SOUND,
    about=r'time|skew|left|right',
    drive='timed',
    factor=3.0,
)
def times_constant(drive: Recording, folder: Path) -> Path:
    """All point times are the same."""
    return _timed(drive, '<f4', lambda t, _: 0.0 * t + 0.05).write(folder / 'bag')


@lie(WARNED, about=r'time|skew|left|right', drive='timed')
def times_noise(drive: Recording, folder: Path) -> Path:
    """Point times are noise."""
    rng = np.random.default_rng(2)
    made = _timed(drive, '<f4', lambda t, _: rng.uniform(-1e6, 1e6, len(t)))
    return made.write(folder / 'bag')


@lie(
    MENDED,
    SOUND,
    WARNED,
    about=r'map',
)
def map_beside(drive: Recording, folder: Path) -> Path:
    """A map in the frame map beside the clouds, at a higher rate."""
    made = drive.framed()
    maps: list[Item] = [
        (t + i * 10_000_000, '/registered_cloud', reframed(m, 'map'))
        for t, topic, m in made.items
        if topic == LEFT
        for i in range(3)
    ]
    return made.plus(maps).write(folder / 'bag')


@lie(MENDED, SOUND, WARNED, about=r'copy|copies|filter')
def filtered_copy(drive: Recording, folder: Path) -> Path:
    """A filtered copy of a cloud beside it."""
    made = drive.framed()
    copies: list[Item] = [
        (t + 3_000_000, '/points_left_filtered', cloud_of(m, table(points_of(m)[::3])))
        for t, topic, m in made.items
        if topic == LEFT
    ]
    return made.plus(copies).write(folder / 'bag')


@lie(SOUND, WARNED, about=r'left|right')
def empty_clouds(drive: Recording, folder: Path) -> Path:
    """Every fifth cloud is empty."""
    count = {'n': 0}

    def change(cloud: Any) -> Any:
        count['n'] += 1
        return cloud if count['n'] % 5 else cloud_of(cloud, table(points_of(cloud)[:0]))

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(
    MENDED,
    WARNED,
    REFUSED,
    about=r'sector|partial|sweep',
)
def sectors(drive: Recording, folder: Path) -> Path:
    """Both LiDARs send an eighth of a turn at a time, 80 Hz."""
    return in_sectors(drive, 8).write(folder / 'bag')


@lie(
    WARNED,
    REFUSED,
    about=r'right',
    drive='curve',
)
def frozen_cloud(drive: Recording, folder: Path) -> Path:
    """The right LiDAR repeats one cloud from the second second on."""
    until = drive.start + 2 * NANOSECONDS
    last = [m for m in drive.of(RIGHT) if stamp_of(m) < until][-1]

    def change(cloud: Any) -> Any:
        return cloud if stamp_of(cloud) < until else replace(last, header=cloud.header)

    return drive.each(RIGHT, change).write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'left|right|point')
def blind(drive: Recording, folder: Path) -> Path:
    """All points lie on the car itself, within a metre."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        near = points / np.linalg.norm(points, axis=1, keepdims=True) * 0.4
        return cloud_of(cloud, table(near))

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'truncated|left|right')
def cut_clouds(drive: Recording, folder: Path) -> Path:
    """Clouds declared twice as long as their data."""

    def change(cloud: Any) -> Any:
        return replace(cloud, width=2 * cloud.width, row_step=2 * cloud.row_step)

    return drive.each(LEFT, change).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=LAYOUT)
def bigendian_rows(drive: Recording, folder: Path) -> Path:
    """Big-endian data of several rows, whose row_step counts points, declared little-endian."""

    def change(cloud: Any) -> Any:
        points = points_of(cloud)
        height = 8
        width = len(points) // height
        made = cloud_of(cloud, table(points[: width * height], '>f4'))
        return replace(made, height=height, width=width, row_step=width)

    return drive.each(LIDARS, change).write(folder / 'bag')


@lie(SOUND, drive='timed')
def times_us_counted(drive: Recording, folder: Path) -> Path:
    """Point times in us from the first point, as uint32; the stamp is the first point's."""
    made = _timed(drive, '<u4', lambda t, _: np.round((t - t.min()) * 1e6), 't')
    return made.shifted(LIDARS, -0.1).write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'time|skew', drive='timed', factor=2.0)
def times_absolute_ns(drive: Recording, folder: Path) -> Path:
    """Point times of the epoch in nanoseconds, as float64."""
    made = _timed(drive, '<f8', lambda t, stamp: stamp + t * 1e9, 'timestamp')
    return made.write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'time|skew|clock', drive='timed', factor=2.0)
def times_other_clock(drive: Recording, folder: Path) -> Path:
    """Point times in seconds since power-up, while the stamps are of the epoch."""
    start = drive.start / NANOSECONDS
    made = _timed(drive, '<f8', lambda t, stamp: stamp / NANOSECONDS + t - start + 95.0)
    return made.write(folder / 'bag')


@lie(SOUND, MENDED, WARNED, about=r'time|skew', drive='timed')
def times_reversed(drive: Recording, folder: Path) -> Path:
    """Point times with the wrong sign: they run backwards through the sweep.

    Nobody can tell: ten merged sweeps are as thin as with the right sign (medians of 12 mm that
    differ by 0.1 mm here, and by 1 to 3 per cent on KITTI), for neighbouring sweeps are skewed
    alike. So it may be unsaid, as long as it does the map no harm; over 25 s of bends ATE is 0.019
    m with either sign.
    """
    return _timed(drive, '<f4', lambda t, _: t.min() - t).write(folder / 'bag')


@lie(MENDED, WARNED, REFUSED, about=LAYOUT + '|distance', drive='turns')
def feet(drive: Recording, folder: Path) -> Path:
    """X, y, z in feet."""
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) / 0.3048))).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=LAYOUT + '|mirror', drive='turns')
def mirrored_clouds(drive: Recording, folder: Path) -> Path:
    """Left-handed clouds: y to the right."""
    flip = np.array([1.0, -1.0, 1.0], dtype=np.float32)
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m) * flip))).write(
        folder / 'bag'
    )


@lie(MENDED, WARNED, REFUSED, about=LAYOUT + '|mirror', drive='turns')
def exchanged_xy(drive: Recording, folder: Path) -> Path:
    """X and y of the clouds exchanged."""
    return drive.each(LIDARS, lambda m: cloud_of(m, table(points_of(m)[:, [1, 0, 2]]))).write(
        folder / 'bag'
    )


@lie(WARNED, REFUSED, about=r'left|right', drive='turns')
def frozen_clouds(drive: Recording, folder: Path) -> Path:
    """Both LiDARs repeat a cloud for the second half."""
    until = drive.start + (drive.end - drive.start) // 2
    last: dict[str, Any] = {}
    made = drive
    for topic in LIDARS:
        last[topic] = [m for m in drive.of(topic) if stamp_of(m) < until][-1]
        made = made.each(
            topic,
            lambda m, topic=topic: (
                m if stamp_of(m) < until else replace(last[topic], header=m.header)
            ),
        )
    return made.write(folder / 'bag')


@lie(WARNED, REFUSED, about=r'left|right')
def dust(drive: Recording, folder: Path) -> Path:
    """Nine of ten points are noise around the car."""
    rng = np.random.default_rng(6)

    def change(cloud: Any) -> Any:
        points = points_of(cloud).copy()
        noisy = rng.random(len(points)) < 0.9
        points[noisy] = rng.normal(scale=8.0, size=(int(noisy.sum()), 3))
        return cloud_of(cloud, table(points))

    return drive.each(LIDARS, change).write(folder / 'bag')
