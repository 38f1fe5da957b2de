"""Parser that reads mmdetection3d's Python configs as data and never executes them.

A value is a literal, `dict(...)`, an assigned name, `_base_.name`, an index or slice of a list, `sum` of a list, or
arithmetic of these. Any other expression is stored as `UnevaluatedExpression` with its line, and is refused if it is
needed.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any

from shift3d.detectors.foreign.config_section import UnevaluatedExpression, merged
from shift3d.errors import InputError

_BASE = "_base_"
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
}
_LARGEST = 100_000  # largest length of a list or text in arithmetic
_LARGEST_NUMBER = 10**30


class _NotDataError(Exception):
    """Expression whose value would need execution."""


def read_python_config(path: Path) -> dict[str, Any]:
    """Read the values of a config by name, merged over its `_base_` files: tables are merged, others are replaced.

    Base paths are relative to the config. Raises InputError if a file is missing or not Python, or has statements other
    than assignments to names, imports and constants.
    """
    return _read(path, ())


def _read(path: Path, above: tuple[Path, ...]) -> dict[str, Any]:
    if path in above:
        raise InputError(f"{_BASE} leads back to it", str(path), "Remove the circle")
    try:
        tree = ast.parse(path.read_bytes(), str(path))
    except OSError as error:
        raise InputError("no readable file", str(path), "Check detector.config and its _base_") from error
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        where = f"{path}, line {error.lineno}" if isinstance(error, SyntaxError) else str(path)
        raise InputError("is no Python config", where, "Give the model's config of mmdetection3d") from error
    reader = _Reader(str(path))
    for statement in tree.body:
        reader.take(statement)
    under: dict[str, Any] = {}
    for name in reader.bases():
        under |= _read((path.parent / name).resolve(), (*above, path))
    return merged(under, reader.with_base(under))


class _Reader:
    """Evaluator of the assignments of one file."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._assigned: list[tuple[str, ast.expr]] = []
        self._names: dict[str, Any] = {}

    def take(self, statement: ast.stmt) -> None:
        """Record a statement. Raises InputError for a kind of statement that could change values unnoticed."""
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                self._assigned.append((name, value))
            case ast.Expr(value=ast.Constant()) | ast.Import():
                pass
            case _:
                what = f"is no value with a name: {ast.unparse(statement)[:80]}"
                where = f"{self._file}, line {statement.lineno}"
                raise InputError(what, where, "Write the config with literals: configs are never run")

    def bases(self) -> list[str]:
        found = [value for name, value in self._assigned if name == _BASE]
        value = self._value(found[-1]) if found else []
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) and "\0" not in name for name in names):
            raise InputError(f"{_BASE} is no list of files", self._file, "Give relative paths")
        return list(names)

    def with_base(self, base: dict[str, Any]) -> dict[str, Any]:
        """Evaluate all assignments in order. base: value of `_base_`."""
        self._names = {_BASE: base}
        for name, value in self._assigned:
            if name != _BASE:
                self._names[name] = self._value(value)
        return {name: value for name, value in self._names.items() if name != _BASE}

    def _value(self, node: ast.expr) -> Any:
        try:
            return self._data(node)
        except (_NotDataError, ArithmeticError, TypeError, ValueError, LookupError, RecursionError):
            return UnevaluatedExpression(ast.unparse(node)[:80], self._file, node.lineno)

    def _data(self, node: ast.expr) -> Any:
        match node:
            case ast.Constant(value=value):
                return value
            case ast.List(elts=parts):
                return [self._value(part) for part in parts]
            case ast.Tuple(elts=parts):
                return tuple(self._value(part) for part in parts)
            case ast.Dict(keys=keys, values=values) if None not in keys:
                return {self._data(key): self._value(value) for key, value in zip(keys, values, strict=True) if key}
            case ast.Call(func=ast.Name(id="dict"), args=[], keywords=words) if all(word.arg for word in words):
                return {str(word.arg): self._value(word.value) for word in words}
            case ast.Call(func=ast.Name(id="sum"), args=[numbers], keywords=[]):
                return sum(_plain(self._data(numbers)))
            case ast.Name(id=name) if name in self._names:
                return self._names[name]
            case ast.Attribute(value=inner, attr=name):
                return self._data(inner)[name]
            case ast.Subscript(value=inner, slice=ast.Slice() as cut):
                ends = [None if end is None else self._data(end) for end in (cut.lower, cut.upper, cut.step)]
                return self._data(inner)[slice(*ends)]
            case ast.Subscript(value=inner, slice=index):
                return self._data(inner)[self._data(index)]
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -self._data(operand)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _sized(_OPERATORS[type(op)], _plain(self._data(left)), _plain(self._data(right)))
        raise _NotDataError


def _plain(value: Any) -> Any:
    if isinstance(value, UnevaluatedExpression):
        raise _NotDataError
    return value


def _sized(combine: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Compute a binary operation; refuse lists, texts and numbers whose repeated sums or products fill the memory."""
    sizes = [len(side) if isinstance(side, list | tuple | str) else 0 for side in (left, right)]
    counts = [side for side in (left, right) if isinstance(side, int)]
    if max(sizes) * max(counts, default=1) > _LARGEST or any(abs(count) > _LARGEST_NUMBER for count in counts):
        raise _NotDataError
    return combine(left, right)
