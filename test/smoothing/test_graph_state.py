"""G(t): it is changed by its own methods alone."""

import ast
from dataclasses import fields
from pathlib import Path

import incremental_mapper
from incremental_mapper.smoothing.graph_state import GraphState

PACKAGE = Path(incremental_mapper.__file__).parent
OWN = {'graph_state.py'}
CHANGING = {'append', 'extend', 'insert', 'update', 'add', 'merge', 'pop', 'clear', 'remove'}
FIELDS = {field.name for field in fields(GraphState)}


def is_state(node):
    """Whether an expression is called ``state`` or ``something.state`` or ``something._state``."""
    name = node.id if isinstance(node, ast.Name) else getattr(node, 'attr', '')
    return name in ('state', '_state')


def held(node):
    """The name of G(t)'s field that an expression is, None where it is none."""
    while isinstance(node, ast.Subscript):
        node = node.value
    own = isinstance(node, ast.Attribute) and node.attr in FIELDS and is_state(node.value)
    return node.attr if own else None


def changes(source):
    """Lines at which a piece of code changes a field of G(t) from outside."""
    for node in ast.walk(ast.parse(source)):
        targets = []
        if isinstance(node, ast.Assign | ast.Delete):
            targets = [
                item
                for target in node.targets
                for item in (target.elts if isinstance(target, ast.Tuple) else [target])
            ]
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            targets = [node.func.value] if node.func.attr in CHANGING else []
        if any(held(target) for target in targets):
            yield node.lineno


def test_every_way_of_changing_it_is_noticed():
    for line in (
        'state.frontier = other',
        'self._state.clusters.append(one)',
        'state.prior, state.values = both',
        'mapper.state.factors[3] = factor',
        'state.velocity_known |= True',
        'del state.scans[0]',
    ):
        assert list(changes(line)) == [1], line
    for line in ('pose = state.pose(3)', 'known = state.frontier', 'rows.append(state.frontier)'):
        assert not list(changes(line)), line


def test_nobody_else_changes_it():
    for path in sorted(PACKAGE.rglob('*.py')):
        if path.name not in OWN:
            found = list(changes(path.read_text(encoding='utf-8')))
            assert not found, f'{path.relative_to(PACKAGE)}: {found}'
