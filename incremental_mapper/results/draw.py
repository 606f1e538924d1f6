"""Draws the pictures of a run that is already in its folder, in a process of its own.

    python -m incremental_mapper.results.draw FOLDER

A node that saves a map starts it once the data are in place: drawing takes longer than writing,
and nobody should wait for it. Every picture appears under its name when it is whole.
"""

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from incremental_mapper.errors import MapperError, OutputError
from incremental_mapper.results.finished_run import FinishedRun
from incremental_mapper.visualization.extras import left_out
from incremental_mapper.visualization.pictures import drawn_points
from incremental_mapper.visualization.run_pictures import Shown, draw_run

MODULE = 'incremental_mapper.results.draw'


def draw_folder(folder: Path) -> str | None:
    """Draw what ``map`` draws, except the truth.

    Args:
        folder: The output of a run.

    Returns:
        A remark where matplotlib is missing, so that there are no pictures.

    Raises:
        InputError: The folder is no output of a run, or a file of it is damaged.
        OutputError: A picture cannot be written.
    """
    missing = left_out(['pictures'])
    if missing is not None:
        return missing
    run = FinishedRun(folder)
    points = run.points
    shown = Shown(
        run.trajectory,
        None,
        run.fixes,
        drawn_points(points),
        len(points),
        run.graph,
        run.georeferenced,
    )
    try:
        # Beside their names first; the folder is hidden, and on the same disk.
        scratch = Path(tempfile.mkdtemp(prefix='.pictures.', dir=folder))
        try:
            draw_run(scratch, shown)
            for picture in sorted(scratch.iterdir()):
                picture.replace(folder / picture.name)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise OutputError(f'{folder}: cannot be written ({error.strerror})') from error
    return None


def main(words: Sequence[str] | None = None) -> int:
    """Draw the pictures of the folder that the first word names.

    Args:
        words: The arguments; None takes those of this process.

    Returns:
        The exit status; what is wrong is said in one line on standard error.
    """
    (folder,) = sys.argv[1:] if words is None else words
    try:
        remark = draw_folder(Path(folder))
    except MapperError as error:
        remark = f'no pictures: {error}'
    # The drawing library may raise anything, and a map is worth having without pictures.
    except Exception as error:
        remark = f'no pictures: {type(error).__name__}: {error}'
    if remark is None:
        return 0
    print(remark, file=sys.stderr)
    return 1


if __name__ == '__main__':
    sys.exit(main())
