"""The files in the folder of a run, by their names."""

from incremental_mapper.map.ply import SCANS
from incremental_mapper.results.candidate_table import FILE_NAME
from incremental_mapper.results.manifest import FILE as MANIFEST
from incremental_mapper.results.sessions.session_file import FILE as SESSION

TRAJECTORY, MAP, WINDOWS = 'trajectory.tum', 'map.ply', 'windows.csv'
GRAPH, GRAPH_G2O, STATISTICS = 'graph.json', 'graph.g2o', 'stats.json'
DATA = (TRAJECTORY, MAP, SCANS, GRAPH_G2O, GRAPH, WINDOWS, STATISTICS, SESSION)
FILES = (*DATA, MANIFEST)
JOURNAL = '.journal'
"""How the name of a journal ends."""
EXTRA_FILES = (
    FILE_NAME,
    'trajectory.png',
    'map.png',
    'map_side.png',
    'graph.png',
    'report.html',
    'map_quality.json',
    'finished.json',
)
"""What a run may have besides, and what ``plot`` and ``evaluate`` make of it."""
