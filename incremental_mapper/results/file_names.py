"""The files in the folder of a run, by their names."""

from fnmatch import fnmatch

from incremental_mapper.exports.formats import formats
from incremental_mapper.map.ply import SCANS
from incremental_mapper.results.candidate_table import FILE_NAME
from incremental_mapper.results.manifest import FILE as MANIFEST
from incremental_mapper.results.sessions.session_file import FILE as SESSION
from incremental_mapper.selection.window_record import FILE as WINDOW_FILE

TRAJECTORY, MAP, WINDOWS = 'trajectory.tum', 'map.ply', 'windows.csv'
GRAPH, GRAPH_G2O, STATISTICS = 'graph.json', 'graph.g2o', 'stats.json'
DATA = (TRAJECTORY, MAP, SCANS, GRAPH_G2O, GRAPH, WINDOWS, STATISTICS, SESSION)
FILES = (*DATA, MANIFEST)
FAILED_WINDOWS = WINDOW_FILE.format('[0-9]*')
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


def is_partial(name: str) -> bool:
    """Whether a file is one that a run had not finished: what a program leaves that was killed.

    Args:
        name: Its name, without folders.
    """
    return name.startswith('.') and name.endswith('.partial') and is_of_run(_whole(name))


def is_of_run(name: str) -> bool:
    """Whether a file is one of a run by its name, finished or not.

    Args:
        name: Its name, without folders.
    """
    exported = (form.file_name for form in formats().values())
    known = (*FILES, *EXTRA_FILES, *exported)
    return _whole(name) in known or fnmatch(_whole(name), FAILED_WINDOWS)


def _whole(name: str) -> str:
    partial = name.startswith('.') and name.endswith('.partial')
    return name[1:].removesuffix('.partial') if partial else name
