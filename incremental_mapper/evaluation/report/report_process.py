"""A run's pictures and page, made by a process of its own beside what else is left to do.

While the map is solved and put together a core is idle: the libraries are imported there then. The
pictures are drawn while the files are written, and the page is made of those.
"""

import gc
import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from incremental_mapper.config import Config
from incremental_mapper.errors import MapperError
from incremental_mapper.frontend.scan_servers import helper
from incremental_mapper.helper_process import Helper, streams
from incremental_mapper.map.ply import MapCloud
from incremental_mapper.mapping.mapper import Mapper
from incremental_mapper.mapping.result import MapResult, WindowResult
from incremental_mapper.results.run_folder import shown_of
from incremental_mapper.trajectory import Trajectory
from incremental_mapper.visualization.extras import importable, installed
from incremental_mapper.visualization.run_pictures import Shown, draw_run


class ReportProcess:
    """Draws one run and writes its ``report.html``; a context, at whose end nothing of it goes on.

    Where there is no second core, or its process dies, all is done in this process.
    """

    trouble = ''
    """It is raised by ``end``."""

    def __init__(self, folder: Path, truth: Trajectory | None) -> None:
        """Nothing is done yet.

        Args:
            folder: The output of ``map``.
            truth: The true trajectory, where there is one.
        """
        self._process: Helper | None = None
        self._folder, self._truth = folder.absolute(), truth
        self._shown: Shown | None = None

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

    @contextmanager
    def watch(self, _config: Config) -> Iterator[Self]:
        """Watch the run that is drawn, see ``results.watching``; another one replaces it."""
        yield self

    def window(self, mapper: Mapper, result: WindowResult) -> None:
        """Windows are not drawn."""

    def prepare(self) -> None:
        """A map will be drawn soon."""
        if self._process is None and installed('pictures') and (os.cpu_count() or 1) > 1:
            self._process = helper('incremental_mapper.evaluation.report.report_process')

    def finish(self, result: MapResult, cloud: MapCloud) -> None:
        """Begin to draw."""
        if installed('pictures'):
            self._shown = shown_of(result, cloud, self._truth)
            self._send((self._folder, self._shown))

    def written(self) -> None:
        """Begin to write the page: all data files of the run are there."""
        self._send((self._folder, self._truth))

    def end(self) -> bool:
        """Wait until all is written.

        Returns:
            Whether there are pictures: their library may be missing, or broken.

        Raises:
            InputError: The folder holds no run.
            OutputError: A picture, or the page, cannot be written.
        """
        if self._process is not None:
            answer, _ = self._process.communicate()
            self._process = None
            try:
                error, drawn = pickle.loads(answer)
            except (EOFError, pickle.UnpicklingError):
                pass  # it has died
            else:
                if error is not None:
                    raise error
                return bool(drawn)
        drawn = self._shown is not None and draw_run(self._folder, self._shown)
        _write(self._folder, self._truth)
        return drawn

    def _send(self, request: tuple[Path, Shown | Trajectory | None]) -> None:
        if self._process is not None:
            assert self._process.stdin is not None
            try:
                pickle.dump(request, self._process.stdin, pickle.HIGHEST_PROTOCOL)
                self._process.stdin.flush()
            except OSError:
                pass  # no answer will come, which is noticed there


def _write(folder: Path, truth: Trajectory | None) -> None:
    """Write the page where its libraries are installed."""
    if importable('report.html') and importable('pictures'):
        from incremental_mapper.evaluation.report.run_page import write_run_report

        write_run_report(folder, truth)


def serve(requests: BinaryIO, answers: BinaryIO) -> None:
    """Draw what is asked for, then write the page.

    The answer is what was raised, or None, and whether there are pictures.
    """
    if importable('report.html') and importable('pictures'):
        import incremental_mapper.evaluation.report.run_page  # noqa: F401 (what takes the time)
    error: Any = None
    drawn = False
    try:
        folder, asked = pickle.load(requests)
        while isinstance(asked, Shown):  # again where the run was mapped again
            drawn = draw_run(folder, asked)
            folder, asked = pickle.load(requests)
        _write(folder, asked)
    except EOFError:
        return  # nobody wants it any more
    except MapperError as raised:
        error = raised
    pickle.dump((error, drawn), answers)
    answers.flush()


def main() -> None:
    """Serve on the standard streams."""
    gc.disable()  # it ends before there is much garbage
    serve(*streams())


if __name__ == '__main__':
    main()
