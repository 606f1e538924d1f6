"""The folder of a run that was cut off, made from its journal."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from incremental_mapper.checks.outcome import unreadable_findings
from incremental_mapper.errors import OutputError
from incremental_mapper.results.draw import draw_folder
from incremental_mapper.results.journal.recovery import in_use, opened, recover
from incremental_mapper.results.new_folder import write_folder
from incremental_mapper.results.run_folder import is_whole, write_result
from incremental_mapper.results.run_statistics import RunStatistics
from incremental_mapper.results.sessions.going_on import whole_again


@dataclass(frozen=True, slots=True, eq=False)
class RecoveredRun:
    """A folder that was made of a journal, its statistics, and remarks."""

    folder: Path
    statistics: RunStatistics
    notes: tuple[str, ...]


def recover_journal(
    path: Path, out: Path | None = None, remove: bool = False, pictures: bool = True
) -> RecoveredRun:
    """Make the files that ``map`` and ``save_map`` write, pictures included.

    ``candidates.parquet`` is not among them: what windows chose from is in no journal.

    Args:
        path: The journal.
        out: The folder, a number is added where it exists; None is named as the journal.
        remove: Whether the journal is removed once the folder is complete.
        pictures: Whether pictures are drawn, where they can be.

    Returns:
        The folder, and what is told of it.

    Raises:
        InputError: It is no journal, damaged from its beginning on, empty, or in use.
        OutputError: The folder cannot be written; nothing is left of it.
    """
    target = (out or path.with_suffix('')).expanduser().absolute()
    with opened(path, alone=remove) as file:
        found = recover(path, file)
        of_all = whole_again(found.result, found.config, found.facts)
        unreadable: list[str] = []
        cloud = of_all.result.cloud(found.config.map, unreadable)
        statistics = RunStatistics.of_run(
            of_all.result,
            found.drops,
            of_all.wall + found.wall,
            len(cloud),
            of_all.facts,
            interrupted=True,
            findings=(*found.findings, *unreadable_findings(unreadable)),
        )
        tree = statistics.to_tree()
        notes = list(found.notes)
        if not remove and in_use(file):
            notes.append(f'{path}: its map is still being made; this is what it held by now')

        def write(place: Path) -> None:
            try:
                write_result(place, of_all.result, cloud, tree)
            except OutputError as error:
                if not is_whole(place):
                    raise
                notes.append(str(error).replace(str(place), str(target)))

        folder = write_folder(target, write)
        if remove and not unreadable:
            with suppress(OSError):  # the map is what counts
                path.unlink()
    try:
        remark = draw_folder(folder) if pictures else None
    # The drawing library may raise anything, and a map is worth having without pictures.
    except Exception as error:
        remark = f'no pictures: {" ".join(str(error).split())}'
    return RecoveredRun(folder, statistics, (*notes, *([remark] if remark else [])))
