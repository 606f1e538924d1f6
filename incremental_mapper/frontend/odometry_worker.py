"""A program of its own that prepares one LiDAR's scans: scans in on stdin, results on stdout.

Run by ``odometry_process``. It ends when its stdin does, so it never outlives the mapper.
"""

import os
import pickle
import sys
from collections import Counter
from typing import BinaryIO

from incremental_mapper.errors import MeasurementError
from incremental_mapper.frontend.scan_preparation import ScanPreparer


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Read name and settings, then scans; answer each with a result and new notes."""
    name, config = pickle.load(requests)
    notes: Counter[str] = Counter()
    preparer = ScanPreparer(name, config, notes)
    while True:
        try:
            scan = pickle.load(requests)
        except EOFError:
            return
        try:
            result: object = preparer.prepare(scan)
        except MeasurementError as error:
            result = (error.reason, str(error))
        pickle.dump((result, dict(notes)), answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()
        notes.clear()


def main() -> None:
    """Serve on the standard streams; what libraries print goes to stderr."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), 'wb')
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    serve(sys.stdin.buffer, answers)


if __name__ == '__main__':
    main()
