"""Small faults in Python source, one at a time, each a replaced piece of one line or a few.

Annotations, docstrings, messages of errors, assertions and arguments of decorators are left alone:
what is changed there is nothing that a test of behaviour could see.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass

_COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_OPERATIONS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
    ast.BitXor: ast.BitOr,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_NAMES = {
    'min': 'max',
    'max': 'min',
    'any': 'all',
    'all': 'any',
    'minimum': 'maximum',
    'maximum': 'minimum',
    'argmin': 'argmax',
    'argmax': 'argmin',
    'union': 'intersection',
    'transformFrom': 'transformTo',
    'hstack': 'vstack',
}
_WORDS = {'left': 'right', 'x': 'v', 'v': 'b'}
"""Strings that steer something: the side of a search, kinds of variables."""
_NO_FAULT = {'warm_up', 'serve', 'main'}
"""Functions whose only effect is that something takes less time later, and those that run in a
process of their own, which reads the file without the fault."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """One fault: ``before`` at the offsets [start, end) of the file's bytes becomes ``after``."""

    file: str
    line: int
    start: int
    end: int
    function: str
    kind: str
    before: str
    after: str

    @property
    def id(self) -> str:
        """Names the fault in one state of the code."""
        return f'{self.file}:{self.line}:{self.start}:{self.kind}'

    def applied(self, source: bytes) -> bytes:
        """The file with the fault in it."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def mutants_of(file: str, source: bytes) -> list[Mutant]:
    """Every fault that this tool knows for a file, in the order of the source."""
    found = list(_Places(file, source).walk())
    return sorted(found, key=lambda item: (item.start, item.end, item.kind, item.after))


class _Places:
    def __init__(self, file: str, source: bytes) -> None:
        self._file, self._source = file, source
        self._tree = ast.parse(source)
        self._starts = [0]
        for line in source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def walk(self) -> Iterator[Mutant]:
        yield from self._visit(self._tree, '')

    def _visit(self, node: ast.AST, function: str) -> Iterator[Mutant]:
        match node:
            case ast.Assert() | ast.Raise() | ast.Import() | ast.ImportFrom():
                return
            case ast.FunctionDef(name=name):
                if name in _NO_FAULT:
                    return
                inner = f'{function}.{name}' if function else name
                for child in [*node.args.defaults, *node.args.kw_defaults, *node.body]:
                    if child is not None:
                        yield from self._visit(child, inner)
                return
            case ast.ClassDef(name=name):
                inner = f'{function}.{name}' if function else name
                for child in node.body:
                    yield from self._visit(child, inner)
                return
            case ast.AnnAssign():
                if node.value is not None:
                    yield from self._visit(node.value, function)
                return
            case ast.Expr(value=ast.Constant()) | ast.JoinedStr():
                return
        yield from self._faults(node, function)
        for child in ast.iter_child_nodes(node):
            yield from self._visit(child, function)

    def _faults(self, node: ast.AST, function: str) -> Iterator[Mutant]:
        """Faults of this very node; its children have their own."""

        def made(kind: str, *after: ast.expr | str) -> Iterator[Mutant]:
            for item in after:
                text = item if isinstance(item, str) else f'({ast.unparse(item)})'
                yield self._mutant(node, function, kind, text)

        match node:
            case ast.Compare(left, [operator], [right]):
                other = _COMPARISONS[type(operator)]()
                yield from made('comparison', ast.Compare(left, [other], [right]))
            case ast.Compare(left, operators, rights):
                for i, operator in enumerate(operators):
                    others = [*operators]
                    others[i] = _COMPARISONS[type(operator)]()
                    yield from made('comparison', ast.Compare(left, others, rights))
            case ast.BinOp(left, ast.MatMult(), right):
                yield from made('order', ast.BinOp(right, ast.MatMult(), left))
            case ast.BinOp(left, operator, right) if not _is_text(left) and not _is_text(right):
                yield from made('operator', ast.BinOp(left, _OPERATIONS[type(operator)](), right))
            case ast.BoolOp(ast.And(), values):
                yield from made('operator', ast.BoolOp(ast.Or(), values))
            case ast.BoolOp(ast.Or(), values):
                yield from made('operator', ast.BoolOp(ast.And(), values))
            case ast.UnaryOp(ast.USub() | ast.Not() | ast.Invert(), operand):
                yield from made('sign', operand)
            case ast.IfExp(test, body, orelse):
                yield from made('branch', body, orelse)
            case ast.If(test) | ast.While(test) if not isinstance(test, ast.Compare | ast.UnaryOp):
                yield self._mutant(test, function, 'branch', f'not ({ast.unparse(test)})')
            case ast.Constant(bool() as value):
                yield from made('constant', str(not value))
            case ast.Constant(int() as value):
                yield from made('constant', str(value + 1), *([str(value - 1)] * (value > 0)))
            case ast.Constant(float() as value):
                yield from made('constant', *(['1.0'] if value == 0.0 else [repr(value * 2.0)]))
            case ast.Constant(str() as value) if value in _WORDS:
                yield from made('constant', repr(_WORDS[value]))
            case ast.Name(name) if name in _NAMES and isinstance(node.ctx, ast.Load):
                yield from made('name', _NAMES[name])
            case ast.Attribute(value, name) if name in _NAMES:
                yield from made('name', ast.Attribute(value, _NAMES[name]))
            case ast.Call(ast.Name('abs' | 'sorted' | 'set'), [argument], []):
                yield from made('call', argument)
            case ast.Call(ast.Attribute(value, 'inverse'), [], []):
                yield from made('call', value)
            case ast.Call(ast.Attribute(one, 'compose' | 'between' as name), [other], []):
                yield from made('order', ast.Call(ast.Attribute(other, name), [one], []))
            case ast.AugAssign(target, operator, value):
                other = _OPERATIONS[type(operator)]()
                text = ast.unparse(ast.AugAssign(target, other, value))
                yield from made('operator', text)
                yield from made('statement', 'pass')
            case ast.Expr(ast.Call()):
                yield from made('statement', 'pass')
            case ast.Break():
                yield from made('statement', 'continue')
            case ast.Continue():
                yield from made('statement', 'break')
            case ast.Assign([ast.Attribute() | ast.Subscript()], _):
                yield from made('statement', 'pass')

    def _mutant(self, node: ast.AST, function: str, kind: str, after: str) -> Mutant:
        place: ast.expr = node  # type: ignore[assignment]
        assert place.end_lineno is not None and place.end_col_offset is not None
        start = self._starts[place.lineno - 1] + place.col_offset
        end = self._starts[place.end_lineno - 1] + place.end_col_offset
        before = self._source[start:end].decode()
        # Lines keep their numbers, by which functions are told apart.
        missing = before.count('\n') - after.count('\n')
        if missing and after.startswith('('):
            after = after[:-1] + '\n' * missing + ')'
        return Mutant(self._file, place.lineno, start, end, function, kind, before, after)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
