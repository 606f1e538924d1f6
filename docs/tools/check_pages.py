"""Checks that what the pages tell people to type exists: commands, options, files, settings, names.

    python docs/tools/check_pages.py [--site SITE] [PAGE ...]

Without arguments: README.md, CONTRIBUTING.md and all pages below docs/. Prints a line for every
mistake, and ends with status 1 where there is one. Commands are parsed, not run. With ``--site``
also whether the built pages fetch anything from elsewhere.
"""

import argparse
import ast
import importlib
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path

from said_messages import PACKAGE, ROOT, Mistake, check_messages
from shown_commands import check_command, check_yaml, commands, prompted, split_command

from incremental_mapper.cli.main import COMMANDS
from incremental_mapper.config import Config, LidarSensor, Section
from incremental_mapper.exports.formats import GROUP as FORMATS
from incremental_mapper.selection.strategies import GROUP

GENERATED = (
    'api/',
    'code/files.md',
    'configuration.md',
    'development/changelog.md',
    'development/contributing.md',
)
"""Places of links that are made when the site is built."""

FENCE = re.compile(r'^(?P<indent> *)(?P<mark>```+|~~~+) *(?P<language>[\w+-]*)(?P<rest>.*)$')
CODE_SPAN = re.compile(r'(?<!`)`([^`\n]+)`(?!`)')
LINK = re.compile(r'(?<!\!)\[[^\]]*\]\(([^)\s#]+)(?:#[^)\s]*)?\)|!\[[^\]]*\]\(([^)\s#]+)')
NOT_IN_FILE = re.compile(r'^[<*]|://|^mailto:')
SUFFIXES = re.compile(
    'bag|bin|cff|cfg|csv|db3|g2o|html|json|mcap|md|parquet|pdf|ply|png|py|rviz|svg|tex|toml|tum|'
    'xml|yaml'
)
"""Endings of files: `map.png` is no setting of the section `map`."""
ELSEWHERE = re.compile(r'url\([\'"]?((?:https?:)?//[^)\'"]+)')
MADE = ('out/', 'demo_out/', 'compared/', 'site/', 'calibration/', 'sensor_data/')
"""Folders that are made, or belong to a data set."""
SETTING = re.compile(r'^([a-z_]+)\.([A-Za-z_*]+)(\.[A-Za-z_]+)?(?:: (.+))?$')
PATH = re.compile(r'^[\w.-]+(/[\w.-]+)*(/|\.\w+)$')


@dataclass(frozen=True)
class Block:
    """A block of code on a page; ``line`` is that of its first line of code."""

    language: str
    code: str
    line: int


def blocks(text: str) -> Iterator[Block]:
    """The fenced blocks of a page."""
    open_mark, language, indent, start = '', '', 0, 0
    lines: list[str] = []
    for number, line in enumerate(text.splitlines(), start=1):
        match = FENCE.match(line)
        if not open_mark:
            if match:
                open_mark, language = match['mark'], match['language']
                indent, start, lines = len(match['indent']), number + 1, []
        elif match and match['mark'].startswith(open_mark) and not match['language']:
            yield Block(language, '\n'.join(lines), start)
            open_mark = ''
        else:
            lines.append(line[indent:] if line[:indent].isspace() else line)


def code_spans(text: str) -> Iterator[tuple[int, str]]:
    """Line and text of the code within sentences."""
    inside = False
    for number, line in enumerate(text.splitlines(), start=1):
        if FENCE.match(line):
            inside = not inside
        elif not inside:
            for match in CODE_SPAN.finditer(line):
                yield number, match[1]


def check_page(text: str, name: str) -> list[Mistake]:
    """All mistakes of a page."""
    found: list[Mistake] = []

    def note(line: int, messages: Sequence[str]) -> None:
        found.extend(Mistake(name, line, message) for message in messages)

    checks: dict[str, Callable[[str], list[str]]] = {
        'yaml': check_yaml,
        'python': check_python,
        'toml': check_toml,
    }
    for block in blocks(text):
        if block.language in ('sh', 'bash'):
            for line, words in commands(block.code):
                note(block.line + line, check_command(words))
        elif block.language == 'text':
            for line, command in prompted(block.code):
                note(block.line + line, check_command(command))
        elif block.language in checks:
            note(block.line, checks[block.language](block.code))
        elif not block.language:
            note(block.line, ['a block without a language; write text if it is no code'])
    for line, span in code_spans(text):
        note(line, check_span(span))
    return found


def check_toml(code: str) -> list[str]:
    """A block of TOML can be read, and entry points name groups that the package asks for."""
    try:
        tree = tomllib.loads(code)
    except tomllib.TOMLDecodeError as error:
        return [f'no TOML: {error}']
    groups = tree.get('project', {}).get('entry-points', {})
    return [
        f'the package asks for no entry points {name!r}'
        for name in groups
        if name not in (GROUP, FORMATS)
    ]


def check_python(code: str) -> list[str]:
    """A block of Python compiles, and what it imports is there."""
    try:
        tree = ast.parse(code)
    except SyntaxError as error:
        return [f'no Python: {error.msg} in line {error.lineno}']
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [_unimportable(item.name, None) for item in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [_unimportable(node.module, item.name) for item in node.names]
    return [message for message in found if message]


def check_span(span: str) -> list[str]:
    """Code within a sentence: a command, a setting, or a file of the package."""
    first = span.split()[0] if span.split() else ''
    if first in (PACKAGE, 'make') and len(span.split()) > 1:
        words = next(split_command(span))
        if first == PACKAGE and words[1] in COMMANDS and len(words) == 2:
            return []  # names the command, and calls nothing
        return check_command(words)
    if first in ('python', 'pip') and len(span.split()) > 1:
        return check_command(next(split_command(span)))
    setting = SETTING.match(span)
    if setting and setting[1] in Config.model_fields and not SUFFIXES.fullmatch(setting[2]):
        return _check_setting(setting)
    if PATH.match(span) and not span.startswith(MADE):
        return _check_path(span)
    return []


def check_links(text: str, page: Path) -> list[Mistake]:
    """Links between files lead to files; those of built pages are checked by mkdocs."""
    found = []
    for number, line in enumerate(text.splitlines(), start=1):
        for match in LINK.finditer(CODE_SPAN.sub('', line)):
            target = match[1] or match[2]
            if NOT_IN_FILE.search(target) or _is_generated(page.parent / target):
                continue
            if not (page.parent / target).exists():
                name = _shown(page)
                found.append(Mistake(name, number, f'the link to {target} leads nowhere'))
    return found


def check_all(pages: Sequence[Path]) -> list[Mistake]:
    """All mistakes of the pages."""
    found = []
    for path in pages:
        text = path.read_text(encoding='utf-8')
        found += check_page(text, _shown(path)) + check_links(text, path)
        if path.name == 'messages.md':
            found += check_messages(text, _shown(path))
    return found


class _Fetched(HTMLParser):
    """Collects what a browser would fetch by itself from elsewhere."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[int, str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """See HTMLParser."""
        given = dict(attrs)
        place = given.get('src') or (given.get('href') if tag == 'link' else None) or ''
        canonical = tag == 'link' and given.get('rel') in ('canonical', 'next', 'prev')
        if place.startswith(('http:', 'https:', '//')) and not canonical:
            self.found.append((self.getpos()[0], place))


def check_site(site: Path) -> list[Mistake]:
    """No page of the built site fetches anything from elsewhere, nor do its style sheets."""
    found = []
    pages = sorted(site.rglob('*.html'))
    if not pages:
        return [Mistake(str(site), 1, 'holds no page')]
    for page in pages:
        parser = _Fetched()
        parser.feed(page.read_text(encoding='utf-8'))
        found += [Mistake(str(page), line, f'fetches {place}') for line, place in parser.found]
    for sheet in sorted(site.rglob('*.css')):
        for place in ELSEWHERE.findall(sheet.read_text(encoding='utf-8')):
            found.append(Mistake(str(sheet), 1, f'fetches {place}'))
    return found


def all_pages() -> list[Path]:
    """README.md, CONTRIBUTING.md and everything below docs/."""
    return [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').rglob('*.md'))]


def _check_setting(setting: re.Match[str]) -> list[str]:
    section, name, deeper, value = setting.groups()
    if '*' in name:
        return []
    if section == 'lidars':
        return [] if name == 'names' else _check_sensor(name, deeper)
    kind = Config.model_fields[section].annotation
    fields = kind.model_fields if isinstance(kind, type) and issubclass(kind, Section) else {}
    if name not in fields:
        return [f'{section}.{name} is no setting; {section} has {", ".join(sorted(fields))}']
    return [] if value is None else check_yaml(f'{section}:\n  {name}: {value}')


def _check_sensor(lidar: str, field: str | None) -> list[str]:
    if field is None or field[1:] in LidarSensor.model_fields:
        return []
    return [
        f'lidars.{lidar}{field} is no setting; a LiDAR has {", ".join(LidarSensor.model_fields)}'
    ]


def _check_path(span: str) -> list[str]:
    """A folder, or a file with a folder before it, is below the root or the package."""
    if '/' not in span:
        return []
    places = [ROOT / span, ROOT / PACKAGE / span, ROOT / 'docs' / span]
    return [] if any(place.exists() for place in places) else [f'{span} does not exist']


def _unimportable(module: str, name: str | None) -> str:
    try:
        found = importlib.import_module(module)
        if name is None or name == '*' or hasattr(found, name):
            return ''
        importlib.import_module(f'{module}.{name}')
    except ImportError as error:
        return f'cannot import {name or module} ({error})'
    return ''


def _is_generated(target: Path) -> bool:
    place = target.resolve()
    docs = ROOT / 'docs'
    inside = place.relative_to(docs).as_posix() if place.is_relative_to(docs) else ''
    return bool(inside) and any(inside.startswith(start) for start in GENERATED)


def _shown(path: Path) -> str:
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else str(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Check the pages; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('pages', type=Path, nargs='*', metavar='PAGE')
    parser.add_argument('--site', type=Path, metavar='DIR', help='the built site, to check as well')
    args = parser.parse_args(arguments)
    pages = [path.resolve() for path in args.pages] or all_pages()
    mistakes = check_all(pages)
    if args.site is not None:
        mistakes += check_site(args.site)
    for mistake in mistakes:
        print(mistake, file=sys.stderr)
    print(f'{len(pages)} pages, {len(mistakes)} mistakes')
    return 1 if mistakes else 0


if __name__ == '__main__':
    sys.exit(main())
