"""Checks of the commands that pages show, and of the settings that they hand over."""

import contextlib
import io
import re
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from importlib.metadata import metadata
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

from said_messages import PACKAGE, ROOT

from incremental_mapper.cli.main import make_parser
from incremental_mapper.datasets.bag_settings import SETTINGS_FILE
from incremental_mapper.errors import ConfigError
from incremental_mapper.selection.strategies import labelled, strategy_names
from incremental_mapper.settings import make_config, read_yaml

SERVICES = ('flush', 'save_map', 'reset', 'pause')
OTHERS = ('evalio', 'cd', 'colcon', 'dask', 'export', 'git', 'ls', 'source', 'touch')
"""Programs whose arguments are not ours to check."""


def commands(code: str) -> Iterator[tuple[int, list[str]]]:
    """Every command of a shell block with its line in it; raises ValueError for open quotes."""
    lines = code.splitlines()
    number = 0
    while number < len(lines):
        start, text = number, lines[number]
        while text.endswith('\\') and number + 1 < len(lines):
            number += 1
            text = text[:-1] + ' ' + lines[number].strip()
        number += 1
        for words in split_command(text.removeprefix('$ ')):
            yield start, words


def prompted(code: str) -> Iterator[tuple[int, list[str]]]:
    """The commands of a transcript: what stands behind a prompt."""
    for number, line in enumerate(code.splitlines()):
        if line.startswith('$ '):
            for words in split_command(line[2:]):
                yield number, words


def split_command(text: str) -> Iterator[list[str]]:
    """The simple commands of a line, without comments and settings of the environment."""
    lexer = shlex.shlex(text, posix=True, punctuation_chars='|;&')
    lexer.whitespace_split = True
    lexer.commenters = '#'
    words: list[str] = []
    for word in [*lexer, ';']:
        if word and set(word) <= set('|;&'):
            while words and re.fullmatch(r'[A-Z_]+=.*', words[0]):
                words = words[1:]
            if words:
                yield words
            words = []
        else:
            words.append(word)


def check_command(words: Sequence[str]) -> list[str]:
    """What is wrong with a command."""
    program, arguments = Path(words[0]).name, list(words[1:])
    if program == PACKAGE:
        return check_mapper(arguments)
    if program == 'mapper_node':
        return check_node(arguments)
    if program in ('python', 'python3'):
        return check_script(arguments)
    if program == 'make':
        return check_make(arguments)
    if program == 'pip':
        return check_pip(arguments)
    if program == 'ros2':
        return check_ros2(arguments)
    if program in OTHERS:
        return []
    return [f'{words[0]!r} is no program that these pages know']


def check_mapper(arguments: Sequence[str]) -> list[str]:
    """Parse a call of ``incremental_mapper`` with its own parser."""
    said = io.StringIO()
    call = shlex.join([PACKAGE, *arguments])
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            args = make_parser(arguments[0] if arguments else None).parse_args(list(arguments))
        except SystemExit as end:
            if end.code in (0, None):
                return []
            reason = said.getvalue().strip().splitlines()[-1]
            return [f'{call!r}: {reason}']
    files = [getattr(args, 'config', None), getattr(args, 'reference', None)]
    found = [_missing(str(file)) for file in files if file is not None]
    if isinstance(getattr(args, 'strategies', None), str):
        found += [
            f'{call!r}: {name!r} is no strategy'
            for name in args.strategies.split(',')
            if labelled(name)[0] not in strategy_names()
        ]
    return [message for message in found if message]


def check_node(arguments: Sequence[str]) -> list[str]:
    """Parameter files of ``mapper_node`` exist, and its parameters are settings."""
    found = []
    for option, value in pairwise(arguments):
        if option == '--params-file' and Path(value).name != SETTINGS_FILE:
            found.append(_missing(value))
        elif option == '-p':
            name, mark, given = value.partition(':=')
            found.append('' if mark else f'-p {value!r}: expected NAME:=VALUE')
            # These are ROS's own, not of the schema.
            if not name.startswith('qos_overrides.'):
                found += check_yaml(_as_yaml(name, given))
    known = ('--ros-args', '--params-file', '-p', '-r', '--remap')
    found += [
        f'mapper_node has no option {word!r}'
        for word in arguments
        if word.startswith('-') and word not in known
    ]
    return [message for message in found if message]


def check_script(arguments: Sequence[str]) -> list[str]:
    """A Python script exists and knows its options; so does a module after ``-m``."""
    if not arguments:
        return []
    if arguments[0] == '-m':
        module = arguments[1]
        return [] if module in OTHERS or find_spec(module) else [f'no module {module!r}']
    if arguments[0] == '-c':
        return []
    path = ROOT / arguments[0]
    if not path.is_file():
        return [f'{arguments[0]} does not exist']
    text = path.read_text(encoding='utf-8')
    options = [word.partition('=')[0] for word in arguments[1:] if word.startswith('--')]
    return [
        f'{arguments[0]} has no option {option}'
        for option in options
        if not re.search(rf"['\"]{re.escape(option)}['\"]", text)
    ]


def check_make(arguments: Sequence[str]) -> list[str]:
    """Targets and variables of ``make`` are in the Makefile."""
    text = (ROOT / 'Makefile').read_text(encoding='utf-8')
    targets = set(re.findall(r'^([a-z_-]+):', text, re.MULTILINE))
    variables = set(re.findall(r'^([A-Z_]+) *\?=', text, re.MULTILINE))
    found = []
    for word in arguments:
        name, mark, _ = word.partition('=')
        if mark and name not in variables:
            found.append(f'the Makefile has no variable {name}')
        elif not mark and not word.startswith('-') and word not in targets:
            found.append(f'the Makefile has no target {word!r}')
    return found


def check_pip(arguments: Sequence[str]) -> list[str]:
    """Extras exist, of this package where it is installed from here or by name."""
    extras = set(metadata(PACKAGE).get_all('Provides-Extra') or ())
    found = []
    for word in arguments:
        match = re.fullmatch(rf'(?:\.|{PACKAGE})\[([\w,-]+)\]', word)
        if match:
            found += [
                f'{word!r}: no extra {name!r}; there are {", ".join(sorted(extras))}'
                for name in match[1].split(',')
                if name not in extras
            ]
    return found


def check_ros2(arguments: Sequence[str]) -> list[str]:
    """Services that are called are the node's."""
    if list(arguments[:2]) == ['service', 'call']:
        name = Path(arguments[2])
        if name.parent.name == PACKAGE and name.name not in SERVICES:
            return [f'the node has no service {name.name!r}']
    if list(arguments[:1]) == ['run'] and list(arguments[1:3]) != [PACKAGE, 'mapper_node']:
        return [f'ros2 run {" ".join(arguments[1:])}: expected {PACKAGE} mapper_node']
    if list(arguments[:1]) == ['run']:
        return check_node(arguments[3:])
    return []


def check_yaml(code: str) -> list[str]:
    """A block of settings is what the schema takes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'settings.yaml'
        path.write_text(code, encoding='utf-8')
        try:
            make_config(read_yaml(path), 'settings')
        except ConfigError as error:
            return [str(error).replace(f'{path}: ', '')]
    return []


def _missing(file: str) -> str:
    """A complaint where a file of the repository is named that is not there."""
    inside = Path(file).parts[0] in ('config', 'docs', 'examples', 'benchmarks')
    return f'{file} does not exist' if inside and not (ROOT / file).exists() else ''


def _as_yaml(name: str, value: str) -> str:
    *sections, last = name.split('.')
    lines = ['  ' * depth + f'{section}:' for depth, section in enumerate(sections)]
    return '\n'.join([*lines, '  ' * len(sections) + f'{last}: {value}'])
