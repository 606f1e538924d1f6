"""A run's page, written by a process of its own beside what else is left to do.

While the map is solved and put together a core is idle: the libraries are imported there then.
"""

import os
import pickle
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from incremental_mapper.errors import MapperError
from incremental_mapper.frontend.scan_servers import helper
from incremental_mapper.helper_process import Helper, streams
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.extras import importable, installed


class ReportProcess:
    """Writes ``report.html`` of one run; a context, at whose end nothing of it goes on.

    Where there is no second core, or its process dies, the page is written in this process.
    """

    def __init__(self) -> None:
        self._process: Helper | None = None
        self._wanted: tuple[Path, Trajectory | None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def prepare(self) -> None:
        """A page will be wanted soon."""
        possible = installed('report.html') and installed('pictures')
        if self._process is None and possible and (os.cpu_count() or 1) > 1:
            self._process = helper('incremental_mapper.evaluation.report.report_process')

    def begin(self, folder: Path, truth: Trajectory | None) -> None:
        """Begin to write.

        Args:
            folder: The output of ``map``; its data files are written.
            truth: The true trajectory, where there is one.
        """
        self._wanted = folder.absolute(), truth
        if self._process is not None:
            assert self._process.stdin is not None
            try:
                pickle.dump(self._wanted, self._process.stdin)
                self._process.stdin.flush()
            except OSError:
                pass  # no answer will come, which is noticed there

    def end(self) -> None:
        """Wait until the page is written.

        Raises:
            InputError: The folder holds no run.
            OutputError: The page cannot be written.
        """
        assert self._wanted is not None
        if self._process is None:
            _write(*self._wanted)
            return
        answer, _ = self._process.communicate()
        self._process = None
        try:
            error = pickle.loads(answer)
        except (EOFError, pickle.UnpicklingError):  # it has died
            _write(*self._wanted)
            return
        if error is not None:
            raise error


def _write(folder: Path, truth: Trajectory | None) -> None:
    """Write the page where its libraries are installed."""
    if importable('report.html') and importable('pictures'):
        from incremental_mapper.evaluation.report.run_page import write_run_report

        write_run_report(folder, truth)


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Write the page that is asked for; the answer is what was raised, or None."""
    if importable('report.html') and importable('pictures'):
        import incremental_mapper.evaluation.report.run_page  # noqa: F401 (what takes the time)
    error: Any = None
    try:
        _write(*pickle.load(requests))
    except EOFError:
        return  # nobody wants it any more
    except MapperError as raised:
        error = raised
    pickle.dump(error, answers)
    answers.flush()


def main() -> None:
    """Serve on the standard streams."""
    serve(*streams())


if __name__ == '__main__':
    main()
