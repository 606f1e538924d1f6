"""Pages about the package's files, made from the files: what there is, and the API room by room."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / 'incremental_mapper'
FRONT_MATTER = '---\nsearch:\n  boost: 0.2\n---'
"""Other pages come first in the search."""
GROUND = 'ground'
"""What the modules beside the rooms are called."""


def rooms() -> list[str]:
    """Names of the rooms: folders directly below the package that hold modules."""
    return sorted(p.parent.name for p in PACKAGE.glob('*/__init__.py'))


def modules(room: str) -> list[Path]:
    """The modules of a room and of the folders in it, door plates apart."""
    if room == GROUND:
        return sorted(p for p in PACKAGE.glob('*.py') if not p.stem.startswith('__'))
    return sorted(p for p in (PACKAGE / room).rglob('*.py') if not p.stem.startswith('__'))


def docstring(path: Path) -> str:
    """The docstring of a module."""
    return ast.get_docstring(ast.parse(path.read_text(encoding='utf-8'))) or ''


def door_plate(room: str) -> str:
    """What a room says of itself."""
    if room == GROUND:
        return 'The ground on which all rooms stand; nothing here imports from a room.'
    return docstring(PACKAGE / room / '__init__.py')


def files_page() -> str:
    """Every file with the first line of its docstring, room by room."""
    parts = [
        '# Every file',
        'Made from the docstrings when these pages are built. '
        'What the rooms are for and how they hang together is in '
        '[How it is laid out](layout.md).',
    ]
    for room in [*rooms(), GROUND]:
        title = f'`{room}/`' if room != GROUND else 'The ground: beside the rooms'
        rows = [f'| `{_within(room, path)}` | {_first_line(path)} |' for path in modules(room)]
        table = '\n'.join(['| file | what it is |', '|---|---|', *rows])
        api = f'[API of this room](../api/{room}.md)'
        parts += [f'## {title} {{#{room}}}', f'{door_plate(room)}\n\n{api}', table]
    return '\n\n'.join(parts) + '\n'


def titles() -> dict[str, str]:
    """Place and title of the pages of the API, rooms first."""
    return {f'api/{room}.md': room for room in [*rooms(), GROUND]}


def api_pages() -> dict[str, str]:
    """A page a room, with all its public names."""
    pages = {}
    for room in [*rooms(), GROUND]:
        parts = [FRONT_MATTER, f'# {room}', door_plate(room)]
        for path in modules(room):
            place = path.relative_to(PACKAGE)
            name = '.'.join(['incremental_mapper', *place.with_suffix('').parts])
            parts.append(
                f'## {_within(room, path)} {{#{name}-file}}\n\n'
                f'::: {name}\n    options:\n      show_root_heading: false\n'
                '      show_root_toc_entry: false\n      heading_level: 3'
            )
        pages[f'api/{room}.md'] = '\n\n'.join(parts) + '\n'
    return pages


def _within(room: str, path: Path) -> str:
    """A module's place in its room."""
    return path.relative_to(PACKAGE if room == GROUND else PACKAGE / room).as_posix()


def _first_line(path: Path) -> str:
    text = docstring(path)
    first = text.split('\n\n')[0].splitlines()
    return ' '.join(first[:1]).replace('``', '`').replace('|', '\\|')
