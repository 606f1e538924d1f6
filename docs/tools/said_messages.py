"""What the program says that users may look for: refusals, reasons and rules, found in the code."""

import ast
import functools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = 'incremental_mapper'
FINDINGS = '## Findings'
"""Where the page of messages has the rules of findings."""


@dataclass(frozen=True)
class Mistake:
    """Something on a page that does not exist."""

    page: str
    line: int
    message: str

    def __str__(self) -> str:
        return f'{self.page}:{self.line}: {self.message}'


def check_messages(text: str, name: str) -> list[Mistake]:
    """Every refusal, reason of a dropped measurement and rule of a finding is on the page."""
    plain = ' '.join(re.sub(r'[`*\\]', '', text).split())
    # Of several places that say the same the last is told.
    said = {' '.join(fragment.split()): place for place, fragment in refusals()}
    reasons = {reason: place for place, reason in drop_reasons()}
    section = plain.partition(FINDINGS)[2]
    rules = {rule: place for place, rule in finding_rules()}
    missing = [item for item in said.items() if item[0] not in plain]
    missing += [item for item in reasons.items() if not re.search(rf'\b{item[0]}\b', plain)]
    # A rule that is put together has a fixed end.
    missing += [item for item in rules.items() if not re.search(rf'{item[0]}\b', section)]
    return [Mistake(name, 1, f'does not tell of {what!r} ({place})') for what, place in missing]


def refusals() -> Iterator[tuple[str, str]]:
    """Where the package refuses something, and the longest fixed piece of what it says."""
    for path, nodes in _sources():
        for node in nodes:
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                called = node.exc.func
                if isinstance(called, ast.Name) and called.id in (
                    'InputError',
                    'ConfigError',
                    'OutputError',
                ):
                    fragment = _longest_text(node.exc)
                    if len(fragment) > 3:
                        yield f'{path}:{node.lineno}', fragment


def drop_reasons() -> Iterator[tuple[str, str]]:
    """Where a measurement is left out, and the key that it is counted under."""
    for path, nodes in _sources():
        for node in nodes:
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                if node.func.id == 'MeasurementError' and node.args:
                    yield from _constants(f'{path}:{node.lineno}', node.args[0])
            elif isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple):
                value = node.value
                label = value.attr if isinstance(value, ast.Attribute) else ''
                label = value.id if isinstance(value, ast.Name) else label
                if label.strip('_').endswith('drops'):
                    yield from _constants(f'{path}:{node.lineno}', node.slice.elts[-1])


def finding_rules() -> Iterator[tuple[str, str]]:
    """Where something is found wrong, and the rule word of the finding."""
    for path, nodes in _sources():
        # Functions that are given the word by their callers, in the same file.
        given = {
            node.name
            for node in nodes
            if isinstance(node, ast.FunctionDef) and [a.arg for a in node.args.args][:1] == ['rule']
        }
        for node in nodes:
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                if node.func.id in {'Finding', 'Remark', *given} and node.args:
                    yield from _rule_words(f'{path}:{node.lineno}', node.args[0])
            elif isinstance(node, ast.Assign) and [ast.unparse(t) for t in node.targets] == [
                'rule'
            ]:
                yield from _rule_words(f'{path}:{node.lineno}', node.value)


def _rule_words(place: str, node: ast.expr) -> Iterator[tuple[str, str]]:
    """The words that an expression may be; of a formatted one its fixed part."""
    if isinstance(node, ast.IfExp):
        yield from _rule_words(place, node.body)
        yield from _rule_words(place, node.orelse)
    elif isinstance(node, ast.JoinedStr):
        for part in node.values:
            yield from _constants(place, part)
    else:
        yield from _constants(place, node)


@functools.cache
def _sources() -> Sequence[tuple[str, Sequence[ast.AST]]]:
    """Each file's nodes in the order of ``ast.walk``: three look for something in all of them."""
    return [
        (str(path.relative_to(ROOT)), list(ast.walk(ast.parse(path.read_text(encoding='utf-8')))))
        for path in sorted((ROOT / PACKAGE).rglob('*.py'))
    ]


def _longest_text(call: ast.Call) -> str:
    texts = [
        node.value
        for node in ast.walk(call)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    return max((text.strip(' .:;,()"\'') for text in texts), key=len, default='')


def _constants(place: str, node: ast.expr) -> Iterator[tuple[str, str]]:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield place, node.value
