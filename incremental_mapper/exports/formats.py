"""The formats, and how they are found.

Others come in by the entry-point group ``incremental_mapper.formats`` of any installed package:
each entry names a ``Format``.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from incremental_mapper.errors import ConfigError, OutputError
from incremental_mapper.exports import graph_files, point_files, trajectory_files
from incremental_mapper.exports.exported_run import ExportedRun

GROUP = 'incremental_mapper.formats'
"""Entry points of other packages."""
INSTALL = 'pip install "incremental_mapper[formats]"'


class Content(StrEnum):
    """What of a run a format holds."""

    MAP = 'map'
    TRAJECTORY = 'trajectory'
    GRAPH = 'graph'


@dataclass(frozen=True, slots=True)
class Format:
    """A format that a run can be written in.

    Attributes:
        name: What it is asked for by, in lower case, such as ``laz``.
        content: What of a run it holds.
        write: Writes a run into a file, in the coordinate system that the user names or None;
            returns remarks, one line each. It raises MapperError or OSError where it cannot.
        suffixes: Endings of files that are taken for it.
        libraries: Modules that it needs and that may be missing.
        systems: Whether it holds a coordinate system.
        stem: What a file of it is called in a run's folder, by default what it holds.
        install: What to type where a library is missing.
    """

    name: str
    content: Content
    write: Callable[[ExportedRun, Path, str | None], Sequence[str]]
    suffixes: tuple[str, ...]
    libraries: tuple[str, ...] = ()
    systems: bool = False
    stem: str = ''
    install: str = INSTALL

    @property
    def file_name(self) -> str:
        """What a file of it is called in a run's folder."""
        return f'{self.stem or self.content}{self.suffixes[0]}'

    def missing(self) -> tuple[str, ...]:
        """Its libraries that are not installed."""
        return tuple(name for name in self.libraries if not _importable(name))


LAZ_NEEDS = ('laspy', 'lazrs', 'pyproj')
BUILT_IN = (
    Format('ply', Content.MAP, point_files.write_ply, ('.ply',), stem='map_all'),
    Format('pcd', Content.MAP, point_files.write_pcd, ('.pcd',)),
    Format('laz', Content.MAP, point_files.write_las, ('.laz',), LAZ_NEEDS, systems=True),
    Format('las', Content.MAP, point_files.write_las, ('.las',), LAZ_NEEDS, systems=True),
    Format('tum', Content.TRAJECTORY, trajectory_files.write_tum_file, ('.tum',)),
    Format('kitti', Content.TRAJECTORY, trajectory_files.write_kitti, ('.kitti', '.txt')),
    Format('csv', Content.TRAJECTORY, trajectory_files.write_csv, ('.csv',)),
    Format('gpx', Content.TRAJECTORY, trajectory_files.write_gpx, ('.gpx',), ('gpxpy',)),
    Format('kml', Content.TRAJECTORY, trajectory_files.write_kml, ('.kml',)),
    Format('geojson', Content.TRAJECTORY, trajectory_files.write_geojson, ('.geojson',)),
    Format('g2o', Content.GRAPH, graph_files.write_g2o, ('.g2o',)),
    Format('json', Content.GRAPH, graph_files.write_json, ('.json',)),
)


def formats() -> dict[str, Format]:
    """The formats that are installed, by name; the built-in ones first.

    Raises:
        ConfigError: One of another package cannot be loaded, or has a name that is taken.
    """
    return {form.name: form for form in (*BUILT_IN, *_others())}


def find_format(path: Path, name: str | None = None) -> Format:
    """The format of a file.

    Args:
        path: The file; its suffix tells the format where ``name`` does not.
        name: The format's own name.

    Raises:
        ConfigError: There is none of that name or suffix.
    """
    known = formats()
    if name is not None:
        return named(name, 'the format')
    suffix = path.suffix.lower()
    for form in known.values():
        if suffix in form.suffixes:
            return form
    endings = ', '.join(ending for form in known.values() for ending in form.suffixes)
    raise ConfigError(f'{path}: the suffix {suffix!r} tells no format; expected one of {endings}')


def named(name: str, place: str) -> Format:
    """The format of a name.

    Args:
        name: Such as ``laz``.
        place: What asks for it, for the message.

    Raises:
        ConfigError: There is none.
    """
    known = formats()
    if name not in known:
        raise ConfigError(f'{place} is {name!r}; known formats: {", ".join(known)}')
    return known[name]


def check_formats(names: Iterable[str]) -> None:
    """Check that formats can be written, before anything is mapped.

    Args:
        names: The setting ``map.formats``.

    Raises:
        ConfigError: One is not known, or a library of it is missing.
    """
    for name in names:
        form = named(name, 'map.formats')
        missing = form.missing()
        if missing:
            raise ConfigError(f'map.formats: {_lacking(name, missing, form.install)}')


def export(run: ExportedRun, form: Format, path: Path, crs: str | None = None) -> Sequence[str]:
    """Write a run in a format.

    Args:
        run: The run.
        form: The format.
        path: The file; what it held is replaced once the new one is whole.
        crs: The coordinate system that the user names; None takes the UTM zone.

    Returns:
        Remarks, one line each.

    Raises:
        ConfigError: The coordinate system is none that this format or this place can have.
        InputError: The run cannot be read, or lacks what the format holds.
        OutputError: A library is missing, or the file cannot be written.
    """
    missing = form.missing()
    if missing:
        raise OutputError(f'{path}: not written: {_lacking(form.name, missing, form.install)}')
    beside = path.with_name(f'.{path.name}.partial')
    try:
        try:
            remarks = form.write(run, beside, crs)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror or error})') from error
    return remarks


def _lacking(name: str, missing: Sequence[str], install: str) -> str:
    verb = 'is' if len(missing) == 1 else 'are'
    return f'{name} needs {", ".join(missing)}, which {verb} missing; {install}'


def _importable(library: str) -> bool:
    try:
        import_module(library)
    # One that was built against another library than is installed raises what it likes.
    except Exception:
        return False
    return True


@cache
def _others() -> tuple[Format, ...]:
    found: dict[str, Format] = {}
    taken = {form.name for form in BUILT_IN}
    for entry in entry_points(group=GROUP):
        try:
            form = entry.load()
        # A user's module may raise anything on import.
        except Exception as error:
            raise ConfigError(
                f'format {entry.name!r} cannot be loaded from {entry.value}: {error!r}'
            ) from error
        if not isinstance(form, Format):
            raise ConfigError(f'format {entry.name!r}: {entry.value} is no Format')
        if form.name in taken:
            raise ConfigError(f'format {form.name!r} is {entry.value} and another; uninstall one')
        taken.add(form.name)
        found[form.name] = form
    return tuple(found.values())
