"""The trajectory as TUM, KITTI, CSV, GPX, KML and GeoJSON.

Those that draw it on a map of the Earth need a georeferenced run. Stamps are taken for UTC, as
those of ROS are. gpxpy comes with the extra ``formats``.
"""

import csv
import json
import shutil
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from incremental_mapper.exports.exported_run import ExportedRun, known_place, maker, place_of
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.trajectory import Trajectory

COLUMNS = ('stamp_ns', 'x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
ON_EARTH = ('latitude', 'longitude', 'height')
ELLIPSOIDAL = 'heights are above the WGS-84 ellipsoid, not above the sea'
KML = 'http://www.opengis.net/kml/2.2'
GX = 'http://www.google.com/kml/ext/2.2'


def write_tum_file(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """A line ``stamp x y z qx qy qz qw`` a pose."""
    _ = run.trajectory  # is one
    shutil.copyfile(run.folder / 'trajectory.tum', path)
    return ()


def write_kitti(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """The upper three rows of each T_map_base, a line a pose."""
    np.savetxt(path, run.trajectory.matrices()[:, :3].reshape(-1, 12), fmt='%.9f')
    return ('KITTI holds no stamps; its lines are those of trajectory.tum',)


def write_csv(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """A row a pose with a head; with latitude, longitude and height where those are known."""
    poses, place = run.trajectory, place_of(run)
    columns: list[Sequence[float]] = [*poses.positions.T, *poses.quaternions.T]
    formats = ['.9f'] * 7
    if place is not None:
        columns += [*place.geodetic(poses.positions).T]
        formats += ['.10f', '.10f', '.4f']
    with path.open('w', encoding='ascii', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow([*COLUMNS, *(ON_EARTH if place is not None else ())])
        for stamp, *numbers in zip(poses.stamps.tolist(), *columns, strict=True):
            writer.writerow([stamp, *map(format, numbers, formats)])
    return () if place is None else (ELLIPSOIDAL,)


def write_gpx(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """One track with a time and a height a point."""
    import gpxpy.gpx

    track = gpxpy.gpx.GPX()
    track.creator = maker(run)
    segment = gpxpy.gpx.GPXTrackSegment()
    for moment, (latitude, longitude, height) in _earthly(run):
        segment.points.append(
            gpxpy.gpx.GPXTrackPoint(
                round(latitude, 9), round(longitude, 9), round(height, 3), time=moment
            )
        )
    track.tracks.append(gpxpy.gpx.GPXTrack(name=run.folder.resolve().name))
    track.tracks[0].segments.append(segment)
    path.write_text(track.to_xml(), encoding='utf-8')
    return (ELLIPSOIDAL,)


def write_kml(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """A track with its times, on the ground: KML's heights are above the sea."""
    ElementTree.register_namespace('', KML)
    ElementTree.register_namespace('gx', GX)
    root = ElementTree.Element(f'{{{KML}}}kml')
    document = ElementTree.SubElement(root, f'{{{KML}}}Document')
    ElementTree.SubElement(document, f'{{{KML}}}name').text = run.folder.resolve().name
    mark = ElementTree.SubElement(document, f'{{{KML}}}Placemark')
    ElementTree.SubElement(mark, f'{{{KML}}}name').text = 'trajectory'
    track = ElementTree.SubElement(mark, f'{{{GX}}}Track')
    ElementTree.SubElement(track, f'{{{KML}}}altitudeMode').text = 'clampToGround'
    points = list(_earthly(run))
    for moment, _ in points:
        ElementTree.SubElement(track, f'{{{KML}}}when').text = _iso(moment)
    for _, (latitude, longitude, height) in points:
        text = f'{longitude:.9f} {latitude:.9f} {height:.3f}'
        ElementTree.SubElement(track, f'{{{GX}}}coord').text = text
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding='utf-8', xml_declaration=True)
    return (f'{ELLIPSOIDAL}; the track is drawn on the ground',)


def write_geojson(run: ExportedRun, path: Path, _crs: str | None) -> Sequence[str]:
    """A line (RFC 7946, heights above the ellipsoid), and the time of each of its points."""
    points = list(_earthly(run))
    line = [
        [round(longitude, 9), round(latitude, 9), round(height, 3)]
        for _, (latitude, longitude, height) in points
    ]
    # A line has two points at least.
    shape = {'type': 'LineString', 'coordinates': line}
    if len(line) < 2:
        shape = {'type': 'MultiPoint', 'coordinates': line}
    tree = {
        'type': 'FeatureCollection',
        'features': [
            {
                'type': 'Feature',
                'geometry': shape,
                'properties': {
                    'name': run.folder.resolve().name,
                    'creator': maker(run),
                    'coordTimes': [_iso(moment) for moment, _ in points],
                },
            }
        ],
    }
    path.write_text(json.dumps(tree, allow_nan=False) + '\n', encoding='utf-8')
    return ()


def _earthly(run: ExportedRun) -> Iterator[tuple[datetime, NDArray[np.float64]]]:
    """The moment of each pose, and its latitude, longitude (degrees) and height (metres)."""
    poses: Trajectory = run.trajectory
    places = known_place(run).geodetic(poses.positions)
    start = datetime(1970, 1, 1, tzinfo=UTC)
    for stamp, place in zip(poses.stamps.tolist(), places, strict=True):
        yield start + timedelta(microseconds=round(stamp * 1_000_000 / NANOSECONDS)), place


def _iso(moment: datetime) -> str:
    return moment.isoformat(timespec='microseconds').replace('+00:00', 'Z')
