"""``candidates.parquet``: every candidate of every window, and which one won.

Parquet needs pyarrow, which comes with the extra ``report`` and is imported when it is used.
Rows are written in groups, so that a long drive takes no more memory than a short one.
"""

import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from incremental_mapper.candidates.model import Candidate
from incremental_mapper.errors import InputError, OutputError
from incremental_mapper.mapping.result import WindowResult
from incremental_mapper.measurements import NANOSECONDS
from incremental_mapper.selection.choice import Tried
from incremental_mapper.visualization.extras import INSTALL, importable

if TYPE_CHECKING:
    import pyarrow

Row: TypeAlias = dict[str, Any]

FILE_NAME = 'candidates.parquet'
ROWS_A_GROUP = 8192
MEMBERS_A_GROUP = 50_000
"""Members of clusters that wait to be written, at most: some 400 bytes each. Windows that hold a
hundred measurements have rows that are ten times as large as usual."""
FORMAT = 2

COLUMNS = {
    'window': 'index of the window in windows.csv',
    'start_ns': 'start of the window, header stamp in nanoseconds',
    'end_ns': 'end of the window',
    'candidate': 'index of the candidate in its window, in the order of the enumeration',
    'winner': 'whether it was appended; a window whose measurements were carried on has none',
    'clusters': 'clusters in time order, each with its members (sensor, stamp_ns)',
    'members': 'the same as text: members joined by +, clusters by |',
    'connections': 'IMU spans between two clusters, given by their indices (-1: the cluster of '
    'G(t-1)), with the stamps of the clusters and of the first IMU sample inside',
    'n_clusters': 'number of clusters',
    'vertices': 'variables that it adds: poses, velocities and biases',
    'connected': 'whether every variable reaches G(t-1) through factors',
    'solved': 'whether it was solved; null errors and scores were never computed',
    'score': 'what the strategy judges by, the lowest wins; not comparable between windows',
    'score_name': 'which score that is: mom_3, mom_2, mom_1, plane_variance, time_shift, '
    'solver_error, vertices, base, bridged, or a name of your own; empty where nothing was '
    'appended',
    'tied': 'whether its score cannot be told from the lowest (selection.tie_confidence); null '
    'where that was not asked',
    'time_shift_s': 'total time shift in seconds',
    'solver_error': 'sum of the squared Mahalanobis norms of its factors',
}
"""The columns and what they say; the texts are in the file's schema too."""


class CandidateWriter:
    """Writes the file under a partial name, group by group, and renames it at the end."""

    def __init__(self, path: Path) -> None:
        from pyarrow import parquet

        self._path = path
        self._partial = path.with_name(f'.{path.name}.partial')
        self._schema = _schema()
        self._waiting: list[Row] = []
        self._members = 0
        with self._telling():
            self._writer = parquet.ParquetWriter(self._partial, self._schema, compression='zstd')

    def add(self, window: WindowResult) -> None:
        """Add the candidates of a window; raises OutputError where they cannot be written."""
        for row in candidate_rows(window):
            self._waiting.append(row)
            self._members += sum(map(len, row['clusters']))
            if len(self._waiting) >= ROWS_A_GROUP or self._members >= MEMBERS_A_GROUP:
                self._write()

    def finish(self) -> None:
        """Write what is left; only now the file has its name."""
        if self._waiting:
            self._write()
        with self._telling():
            self._writer.close()
            self._partial.replace(self._path)

    def abandon(self) -> None:
        """Leave no file."""
        self._writer.close()
        self._partial.unlink(missing_ok=True)

    def _write(self) -> None:
        from pyarrow import json as tables

        # Python's own objects would make pyarrow import pandas, half a second of it, to see
        # whether they are from there.
        text = '\n'.join(map(json.dumps, self._waiting)).encode()
        columns = tables.ParseOptions(
            explicit_schema=self._schema, unexpected_field_behavior='error'
        )
        room = tables.ReadOptions(block_size=max(len(text), 1))
        table = tables.read_json(io.BytesIO(text), read_options=room, parse_options=columns)
        with self._telling():
            self._writer.write_table(table.cast(self._schema))
        self._waiting, self._members = [], 0

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            reason = error.strerror or str(error)
            raise OutputError(f'{self._path}: cannot be written ({reason})') from error


@contextmanager
def candidate_recorder(path: Path) -> Iterator[Callable[[WindowResult], None] | None]:
    """Write the candidates of windows; a block that fails leaves no file.

    Args:
        path: The file, which has its name only once it is whole.

    Yields:
        A function that adds a window's candidates; None where pyarrow is missing.

    Raises:
        OutputError: The file cannot be written.
    """
    if not importable(FILE_NAME):
        yield None
        return
    writer = CandidateWriter(path)
    try:
        yield writer.add
        writer.finish()
    except BaseException:
        writer.abandon()
        raise


def candidate_rows(window: WindowResult) -> Iterator[Row]:
    """A row for each candidate of a window, with the keys of ``COLUMNS``.

    Args:
        window: A window that the mapper has closed.

    Returns:
        Rows in the order of the enumeration; the winner is among them even where the search had
        left it out.
    """
    tried = list(window.tried)
    if window.winner is not None and all(item.candidate != window.winner for item in tried):
        # A bridge may take a candidate that the search had left out.
        tried.append(Tried(window.winner, connected=False))
    return (_row(window, index, item) for index, item in enumerate(tried))


def read_window(path: Path, window: int) -> list[Row]:
    """The rows of one window.

    Args:
        path: A ``candidates.parquet``.
        window: The window's number, as in ``windows.csv``.

    Returns:
        Rows with the keys of ``COLUMNS`` in the order of the enumeration; none where the window
        has no candidate.

    Raises:
        InputError: The file or pyarrow is missing, or the file is no such table.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise InputError(
            f'{path}: needs pyarrow to be written and read; install it with: {INSTALL}'
        ) from error
    if not path.is_file():
        raise InputError(
            f'{path}: is missing; map the drive again with pyarrow installed: {INSTALL}'
        )
    try:
        table = parquet.read_table(path, filters=[('window', '=', window)])
        rows: list[Row] = table.select(list(COLUMNS)).sort_by('candidate').to_pylist()
    except (pyarrow.ArrowException, OSError, KeyError) as error:
        reason = ' '.join(str(error).split())
        raise InputError(f'{path}: is no table of candidates ({reason})') from error
    return rows


def _row(window: WindowResult, index: int, tried: Tried) -> Row:
    candidate = tried.candidate
    return {
        'window': window.index,
        'start_ns': window.start,
        'end_ns': window.end,
        'candidate': index,
        'winner': candidate == window.winner,
        'clusters': [
            [{'sensor': core.sensor, 'stamp_ns': core.stamp} for core in cluster.members]
            for cluster in candidate.clusters
        ],
        'members': members_text(candidate),
        'connections': [
            {
                'start': link.start,
                'end': link.end,
                'start_ns': link.start_stamp,
                'end_ns': link.end_stamp,
                'first_sample_ns': link.first_sample,
            }
            for link in candidate.connections
        ],
        'n_clusters': len(candidate.clusters),
        'vertices': candidate.vertices,
        'connected': tried.connected,
        'solved': tried.solver_error is not None,
        'score': _finite(tried.score),
        'score_name': window.row['score_name'],
        'tied': tried.tied,
        'time_shift_s': candidate.time_shift / NANOSECONDS,
        'solver_error': _finite(tried.solver_error),
    }


def members_text(candidate: Candidate) -> str:
    """The clusters as ``windows.csv`` writes them, for example ``gnss+left|right``."""
    return '|'.join(
        '+'.join(core.sensor for core in cluster.members) for cluster in candidate.clusters
    )


def _finite(number: float | None) -> float | None:
    return float(number) if number is not None and math.isfinite(number) else None


def _schema() -> 'pyarrow.Schema':
    import pyarrow as pa

    member = pa.struct([('sensor', pa.string()), ('stamp_ns', pa.int64())])
    link = pa.struct(
        [
            ('start', pa.int32()),
            ('end', pa.int32()),
            ('start_ns', pa.int64()),
            ('end_ns', pa.int64()),
            ('first_sample_ns', pa.int64()),
        ]
    )
    types: Mapping[str, Any] = {
        'window': pa.int32(),
        'start_ns': pa.int64(),
        'end_ns': pa.int64(),
        'candidate': pa.int32(),
        'winner': pa.bool_(),
        'clusters': pa.list_(pa.list_(member)),
        'members': pa.string(),
        'connections': pa.list_(link),
        'n_clusters': pa.int32(),
        'vertices': pa.int32(),
        'connected': pa.bool_(),
        'solved': pa.bool_(),
        'score': pa.float64(),
        'score_name': pa.string(),
        'tied': pa.bool_(),
        'time_shift_s': pa.float64(),
        'solver_error': pa.float64(),
    }
    fields: Sequence[pa.Field] = [
        pa.field(name, types[name], metadata={'description': text})
        for name, text in COLUMNS.items()
    ]
    about = {
        'format': str(FORMAT),
        'about': 'incremental_mapper: one row a candidate of a window',
        # Readers that drop the metadata of fields keep that of the table.
        'columns': json.dumps(COLUMNS),
    }
    return pa.schema(fields, metadata=about)
