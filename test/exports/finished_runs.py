"""Folders of runs that nobody mapped: a few poses and points, written by the package's writers."""

import json

import numpy as np
from scipy.spatial.transform import Rotation

from incremental_mapper.map.ply import MapCloud, ScanTable, write_ply, write_scans
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.trajectory import Trajectory, write_tum

START = 1_544_590_798_000_000_000
DATUM = [36.4, 129.0, 90.0]


def write_run(folder, points=5000, light=80.0, datum=DATUM, poses=20):
    folder.mkdir()
    rng = np.random.default_rng(3)
    cloud = rng.uniform([-150.0, -150.0, -2.0], [150.0, 150.0, 20.0], (points, 3))
    if light:
        cloud = np.column_stack([cloud, rng.uniform(0.0, light, points)])
    scans = ScanTable(
        stamps=START + np.arange(40, dtype=np.int64) * NANOSECONDS // 20,
        lidars=(np.arange(40) % 2).astype(np.uint8),
        windows=(np.arange(40) // 2).astype(np.int32),
        names=('left', 'right'),
    )
    first = rng.integers(0, 40, points).astype(np.int32)
    made = MapCloud(cloud.astype(np.float32), first, scans)
    write_ply(folder / 'map.ply', made)
    write_scans(folder / 'map_scans.ply', made)
    turns = Rotation.from_euler('ZYX', rng.uniform(-1.0, 1.0, (poses, 3)))
    positions = rng.uniform(-150.0, 150.0, (poses, 3))
    stamps = START + np.arange(poses, dtype=np.int64) * NANOSECONDS // 10 + 7
    write_tum(folder / 'trajectory.tum', Trajectory(stamps, positions, turns.as_quat()))
    graph = {'format': 1, 'frame': 'map', 'units': '', 'variables': [], 'clusters': []}
    (folder / 'graph.json').write_text(json.dumps({**graph, 'factors': []}))
    (folder / 'graph.g2o').write_text('VERTEX_SE3:QUAT 0 1 2 3 0 0 0 1\n')
    stats = {'strategy': 'mom', 'georeferenced': datum is not None, 'datum': datum}
    (folder / 'stats.json').write_text(json.dumps(stats))
    return FinishedRun(folder)
