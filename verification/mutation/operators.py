"""Small changes of a program, each a mistake that somebody could make: another sign, a dropped term, a missing guard.

Settings (numbers at the top of a module or class), texts, annotations and error messages are left alone: a test is not
expected to pin the value of a setting.
"""

import ast
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any


def _both_ways(*pairs: tuple[Any, Any]) -> dict[Any, Any]:
    return dict(pairs) | {other: one for one, other in pairs}


OTHER_OPERATOR = _both_ways((ast.Add, ast.Sub), (ast.Mult, ast.Div))
OTHER_COMPARISON = _both_ways(
    (ast.Lt, ast.GtE), (ast.Gt, ast.LtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn)
)
OTHER_NAME = _both_ways(
    ("min", "max"), ("minimum", "maximum"), ("any", "all"), ("argmin", "argmax"), ("sum", "mean"), ("sin", "cos"),
    ("zeros", "ones"), ("floor", "ceil"),
) | {"expected": "plug_in", "log_expected": "log_plug_in"}  # fmt: skip
ONLY_ARGUMENT = frozenset({"abs", "sqrt", "exp", "log", "sort", "sorted", "isfinite", "clip", "cumsum", "conj"})
"""Functions whose call is replaced by its first argument."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file: its line, from 1, its bytes from `start` to before `end`, and both texts, on one line."""

    line: int
    start: int
    end: int
    before: str
    after: str

    def applied(self, source: str) -> str:
        """Return the source with the change."""
        data = source.encode()
        return (data[: self.start] + self.after.encode() + data[self.end :]).decode()

    def texts(self) -> dict[str, str]:
        """Return what a table shows of it."""
        return {"line": str(self.line), "start": str(self.start), "before": self.before, "after": self.after}


def mutants(source: str) -> list[list[Mutant]]:
    """Return the mutants of a file, one list for each place, in the order of the file."""
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: dict[tuple[int, int], dict[str, Mutant]] = {}
    for node in _inside_functions(ast.parse(source)):
        for old, new in _changes(node):
            start = starts[old.lineno - 1] + old.col_offset
            end = starts[(old.end_lineno or old.lineno) - 1] + (old.end_col_offset or 0)
            before, after = ast.unparse(old), ast.unparse(new)
            after = f"({after})" if isinstance(new, ast.expr) else after
            if before not in (after, after[1:-1]):
                found.setdefault((start, end), {})[after] = Mutant(old.lineno, start, end, before, after)
    return [list(found[place].values()) for place in sorted(found)]


def _inside_functions(tree: ast.Module) -> Iterator[ast.expr | ast.stmt]:
    """Yield the nodes in bodies of functions that may be changed."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            for statement in node.body:
                yield from _changeable(statement)


def _changeable(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return  # walked on its own
    if isinstance(node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.JoinedStr):
        return
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield node
    for name, child in ast.iter_fields(node):
        if name in ("annotation", "slice", "keywords") and not isinstance(node, ast.Call):
            continue
        for one in child if isinstance(child, list) else [child]:
            if isinstance(one, ast.keyword) and one.arg in ("axis", "dtype", "ndmin"):
                continue
            if isinstance(one, ast.AST):
                yield from _changeable(one)


def _changes(node: ast.expr | ast.stmt) -> Iterator[tuple[ast.expr | ast.stmt, ast.expr | ast.stmt]]:
    """Yield a part of a node, mostly the node itself, and what it may become."""
    match node:
        case ast.If(test=test) if not isinstance(node.body[-1], ast.Raise):
            yield test, ast.Constant(value=False)
        case ast.Assign(targets=[ast.Name(id=name)], value=value) if _mentions(value, name):
            yield node, ast.Pass()
        case ast.AugAssign():
            yield node, ast.Pass()
        case ast.expr():
            for other in _other_expressions(node):
                yield node, other
        case _:
            return


def _other_expressions(node: ast.expr) -> Iterator[ast.expr]:
    match node:
        case ast.BinOp(left=left, op=op, right=right) if not _text(left) and not _text(right):
            if type(op) in OTHER_OPERATOR:
                yield ast.BinOp(left, OTHER_OPERATOR[type(op)](), right)
            if isinstance(op, ast.Add | ast.Sub | ast.Mult | ast.Div | ast.Pow):
                yield left
            if isinstance(op, ast.Sub):
                yield ast.BinOp(right, op, left)
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield operand
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            yield ast.Compare(left, [OTHER_COMPARISON[type(op)]()], [right])
        case ast.BoolOp(op=op, values=values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
            yield values[0]
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value)):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float(value)):
            yield ast.Constant(2 * value if value else 1.0)
        case ast.IfExp(body=body, orelse=orelse):
            yield body
            yield orelse
        case ast.Call(func=func, args=args):
            yield from _other_call(node, func, args)
        case _:
            return


def _other_call(node: ast.Call, func: ast.expr, args: list[ast.expr]) -> Iterator[ast.expr]:
    name = func.attr if isinstance(func, ast.Attribute) else func.id if isinstance(func, ast.Name) else ""
    if name in OTHER_NAME:
        changed = deepcopy(node)
        if isinstance(changed.func, ast.Attribute):
            changed.func.attr = OTHER_NAME[name]
        elif isinstance(changed.func, ast.Name):
            changed.func.id = OTHER_NAME[name]
        yield changed
    if name in ONLY_ARGUMENT and args:
        yield args[0]


def _text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _mentions(value: ast.expr, name: str) -> bool:
    return any(isinstance(one, ast.Name) and one.id == name for one in ast.walk(value))
