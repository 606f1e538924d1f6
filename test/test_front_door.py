"""What ``incremental_mapper`` itself offers: all of it is there, told of, and loaded late."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import incremental_mapper

NAMES = [name for name in incremental_mapper.__all__ if not name.startswith('_')]
FUNCTIONS = [name for name in NAMES if inspect.isfunction(getattr(incremental_mapper, name))]
CLASSES = [name for name in NAMES if inspect.isclass(getattr(incremental_mapper, name))]


def sections(item):
    """Sections of a docstring by name, with the names that each explains."""
    found, title = {}, None
    for line in inspect.getdoc(item).splitlines():
        if line.rstrip(':') in ('Args', 'Returns', 'Raises', 'Attributes', 'Yields'):
            title = line.rstrip(':')
            found[title] = []
        elif title and line.startswith('    ') and not line.startswith('     ') and ':' in line:
            found[title].append(line.strip().split(':')[0].lstrip('*'))
    return found


def explained(function, own):
    """Assert that parameters, result and errors of a function have their sections."""
    told = sections(function)
    signature = inspect.signature(function)
    parameters = [name for name in signature.parameters if name not in ('self', 'cls')]
    assert told.get('Args', []) == parameters, own
    if signature.return_annotation not in (None, 'None', inspect.Signature.empty):
        assert told.keys() & {'Returns', 'Yields'}, own


def test_every_name_is_there_and_every_room_is_named_once():
    assert len(set(NAMES)) == len(NAMES)
    for name in NAMES:
        assert getattr(incremental_mapper, name).__module__.startswith('incremental_mapper.')
    assert set(dir(incremental_mapper)) == set(incremental_mapper.__all__)
    with pytest.raises(AttributeError, match='no_such_name'):
        _ = incremental_mapper.no_such_name


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(incremental_mapper.__file__).read_text())
    guarded = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.name: node.module
        for node in guarded.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    loaded = {
        name: f'incremental_mapper.{room}'
        for room, names in incremental_mapper._ROOMS.items()
        for name in names
    }
    assert seen == loaded
    assert set(seen) == set(NAMES)


def test_nothing_is_loaded_before_it_is_asked_for():
    program = (
        'import sys, incremental_mapper; '
        'print([name for name in ("numpy", "gtsam", "numba") if name in sys.modules])'
    )
    done = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == '[]'


@pytest.mark.parametrize('name', FUNCTIONS)
def test_function_says_what_it_takes_and_gives(name):
    explained(getattr(incremental_mapper, name), name)


@pytest.mark.parametrize('name', CLASSES)
def test_class_says_what_it_holds_and_does(name):
    kind = getattr(incremental_mapper, name)
    assert inspect.getdoc(kind)
    for own, method in vars(kind).items():
        plain = getattr(method, '__func__', method)
        if own.startswith('_') or not inspect.isfunction(plain):
            continue
        assert plain.__doc__, f'{name}.{own}'
        parameters = set(inspect.signature(plain).parameters) - {'self', 'cls'}
        if parameters and 'See ' not in plain.__doc__:
            explained(plain, f'{name}.{own}')
