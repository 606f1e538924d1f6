"""The map as PLY, PCD, LAS and LAZ: intensity, time, LiDAR and window of every point.

All are written in pieces of ``CHUNK`` points, so a map need not fit into memory. laspy and lazrs
come with the extra ``formats``.
"""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.errors import ConfigError
from incremental_mapper.exports.exported_run import ExportedRun, maker, place_of
from incremental_mapper.map.ply import MapFile, Records, ply_header

PCD_TYPES = {'<f4': ('4', 'F'), '<f8': ('8', 'F'), '|u1': ('1', 'U'), '<i4': ('4', 'I')}
"""Sizes and kinds of numbers as PCD names them."""
POINT_FORMAT = 6
"""Of LAS 1.4: with the time of each point, and room for columns of one's own."""
LAS_STEP = 0.001
"""Metres that coordinates in LAS are whole multiples of."""
MOST_LIGHT = 65535
"""The largest intensity that LAS holds; it holds whole numbers."""
GPS_EPOCH = 315_964_800
"""Seconds from 1970 to 1980-01-06, where GPS time begins."""
GPS_SHIFT = 1_000_000_000
"""What LAS takes off GPS seconds, so that doubles tell them finely enough."""
LEAPS = (
    '1981-07-01', '1982-07-01', '1983-07-01', '1985-07-01', '1988-01-01', '1990-01-01',
    '1991-01-01', '1992-07-01', '1993-07-01', '1994-07-01', '1996-01-01', '1997-07-01',
    '1999-01-01', '2006-01-01', '2009-01-01', '2012-07-01', '2015-07-01', '2017-01-01',
)  # fmt: skip
"""From when on GPS is a second further ahead of UTC (IERS Bulletin C; none since)."""
LAS_TEXT = 31
"""Characters that LAS has for what a column means."""


def write_ply(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """The map with all its columns in one file."""
    with path.open('wb') as file:
        file.write(ply_header([('vertex', run.map.count, run.map.dtype)], run.map.lidars))
        for records in run.map.records():
            file.write(records.tobytes())
    return ()


def write_pcd(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """The map as binary PCD 0.7, by hand: pypcd4 holds all points in memory."""
    names = run.map.dtype.names or ()
    kinds = [PCD_TYPES[run.map.dtype[name].str] for name in names]
    head = [
        '# .PCD v0.7 - Point Cloud Data file format',
        *(f'# lidar {number} {name}' for number, name in enumerate(run.map.lidars)),
        'VERSION 0.7',
        f'FIELDS {" ".join(names)}',
        f'SIZE {" ".join(size for size, _ in kinds)}',
        f'TYPE {" ".join(kind for _, kind in kinds)}',
        f'COUNT {" ".join("1" for _ in names)}',
        f'WIDTH {run.map.count}',
        'HEIGHT 1',
        'VIEWPOINT 0 0 0 1 0 0 0',
        f'POINTS {run.map.count}',
        'DATA binary',
        '',
    ]
    with path.open('wb') as file:
        file.write('\n'.join(head).encode())
        for records in run.map.records():
            file.write(records.tobytes())
    return ()


def write_las(run: ExportedRun, path: Path, crs: str | None) -> Sequence[str]:
    """The map as LAS 1.4, compressed where the name says laz, with its coordinate system.

    Without a place on Earth it is written in metres of the map, and says so.

    Raises:
        ConfigError: There is no such coordinate system, or no place for one.
    """
    import laspy

    place = place_of(run)
    if place is None and crs is not None:
        raise ConfigError(
            f'--crs: {run.folder} is not georeferenced, so it cannot be put into {crs}'
        )
    projection = None if place is None else place.projection(crs)
    strongest, first = _strongest(run.map), _first_time(run.map)
    header = laspy.LasHeader(point_format=POINT_FORMAT, version='1.4')
    header.scales = np.full(3, LAS_STEP)
    origin = np.zeros((1, 3)) if projection is None else projection.project(np.zeros((1, 3)))
    header.offsets = np.floor(origin[0])
    header.generating_software = maker(run)[:32]
    header.system_identifier = 'incremental_mapper'
    # Not the day of the export: the same run makes the same file.
    header.creation_date = datetime.fromtimestamp(max(first, 0.0), tz=UTC).date()
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    names = run.map.dtype.names or ()
    own = {'lidar': ('u1', _lidar_text(run.map.lidars)), 'window': ('i4', 'number of the window')}
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams(name=name, type=kind, description=text[:LAS_TEXT])
            for name, (kind, text) in own.items()
            if name in names
        ]
    )
    if projection is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(projection.wkt))
        header.global_encoding.wkt = True
    scale = _light_scale(strongest)
    packed = path.name.removesuffix('.partial').lower().endswith('.laz')
    with laspy.open(path, mode='w', header=header, do_compress=packed) as writer:
        for records in run.map.records():
            writer.write_points(_las_points(records, header, projection, scale))
    return (*_las_remarks(projection), *_light_remarks(scale))


def _las_points(records: Records, header: Any, projection: Any, light: float) -> Any:
    import laspy

    names = records.dtype.names or ()
    points: NDArray[np.float64] = np.stack([records[axis] for axis in 'xyz'], axis=1, dtype='f8')
    if projection is not None:
        points = projection.project(points)
    made = laspy.ScaleAwarePointRecord.zeros(len(records), header=header)
    made.x, made.y, made.z = points.T
    made.return_number[:] = 1
    made.number_of_returns[:] = 1
    if 'intensity' in names:
        light_values = np.rint(records['intensity'] * light)
        made.intensity = np.clip(light_values, 0, MOST_LIGHT).astype(np.uint16)
    if 'time' in names:
        made.gps_time = gps_seconds(records['time']) - GPS_SHIFT
    for name in ('lidar', 'window'):
        if name in names:
            made[name] = records[name]
    return made


def gps_seconds(times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seconds of GPS time.

    Args:
        times: Seconds since 1970 in UTC (N,), as ROS stamps are.
    """
    leaps = [datetime.fromisoformat(f'{day}T00:00:00+00:00').timestamp() for day in LEAPS]
    ahead = np.searchsorted(np.array(leaps), times, side='right')
    return np.asarray(times - GPS_EPOCH + ahead, dtype=np.float64)


def _columns(file: MapFile, name: str) -> Iterator[NDArray[Any]]:
    if name in (file.dtype.names or ()):
        for records in file.records():
            yield records[name]


def _strongest(file: MapFile) -> float:
    return max((float(part.max()) for part in _columns(file, 'intensity')), default=0.0)


def _first_time(file: MapFile) -> float:
    return min((float(part.min()) for part in _columns(file, 'time')), default=0.0)


def _light_scale(strongest: float) -> float:
    """What intensities are multiplied by: only those that whole numbers up to 65535 do not tell."""
    fits = 1.0 < strongest <= MOST_LIGHT
    return 1.0 if fits or strongest <= 0.0 else MOST_LIGHT / strongest


def _lidar_text(names: Sequence[str]) -> str:
    return ', '.join(f'{number} {name}' for number, name in enumerate(names))


def _las_remarks(projection: Any) -> tuple[str, ...]:
    if projection is None:
        return ('the map is not georeferenced: metres in its own frame, no coordinate system',)
    return (f'coordinates in {projection.name}; heights: {projection.heights}',)


def _light_remarks(scale: float) -> tuple[str, ...]:
    return () if scale == 1.0 else (f'intensities are multiplied by {scale:.6g} to fit into LAS',)
