"""Typed access to the values of a config: a missing value or a wrong type raises an error with file and path."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from shift3d.errors import InputError

_REQUIRED: Any = object()
DELETE = "_delete_"
"""Key in a table of mmdetection3d: the table replaces the base table instead of being merged."""


@dataclass(frozen=True)
class UnevaluatedExpression:
    """Expression of a config whose value would need execution."""

    text: str
    file: str
    line: int


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Merge a config over its base: tables are merged, other values are replaced."""
    result = dict(under)
    for key, value in over.items():
        if isinstance(value, dict):
            below = result.get(key)
            kept = below if isinstance(below, dict) and not value.get(DELETE, False) else {}
            value = merged(kept, {name: part for name, part in value.items() if name != DELETE})
        result[key] = value
    return result


@dataclass(frozen=True)
class Section:
    """Table of a config. file: named in error messages. path: of the table, with dots."""

    values: Mapping[str, Any]
    file: str
    path: str = ""

    def refuse(self, what: str, remedy: str = "Give a model that docs/guides/detectors.md lists") -> NoReturn:
        """Raise InputError: this section describes a model that is not supported."""
        raise InputError(f"{self.path}: {what}" if self.path else what, self.file, remedy)

    def has(self, name: str) -> bool:
        return self.values.get(name) is not None

    def get(self, name: str, default: Any = _REQUIRED) -> Any:
        """Return a value, or the default if it is missing. Raises InputError if it is required or not a literal."""
        value = self.values.get(name, default)
        if value is _REQUIRED:
            self.refuse(f"{name} is missing", "Give the config that the model was trained with")
        if isinstance(value, UnevaluatedExpression):
            what = f"{self._name(name)} is no literal: {value.text}"
            raise InputError(what, f"{value.file}, line {value.line}", "Write its value there: configs are never run")
        return value

    def expect(self, name: str, wanted: Any, default: Any = _REQUIRED) -> None:
        """Refuse a value other than `wanted`, or not in `wanted` if that is a tuple."""
        value, known = self.get(name, default), wanted if isinstance(wanted, tuple) else (wanted,)
        if value not in known:
            self.refuse(f"{name} is {repr(value)[:80]}, not {' or '.join(repr(one) for one in known)}")

    def absent(self, *names: str) -> None:
        """Refuse the section if one of these parts, which are not supported, is present."""
        for name in names:
            if self.has(name):
                self.refuse(f"{name} is there")

    def section(self, name: str, default: Mapping[str, Any] = _REQUIRED) -> Section:
        value = self.get(name, default)
        if not isinstance(value, Mapping):
            self._wrong(name, value, "a table")
        return Section(value, self.file, self._name(name))

    def sections(self, name: str) -> list[Section]:
        values = self.sequence(name)
        if not all(isinstance(value, Mapping) for value in values):
            self._wrong(name, values, "a list of tables")
        return [Section(value, self.file, f"{self._name(name)}[{i}]") for i, value in enumerate(values)]

    def number(self, name: str, default: Any = _REQUIRED) -> float:
        return self._number(name, self.get(name, default))

    def whole(self, name: str, default: Any = _REQUIRED) -> int:
        """Return an integer of at least 1."""
        return self._whole(name, self.get(name, default))

    def text(self, name: str, default: Any = _REQUIRED) -> str:
        value = self.get(name, default)
        if not isinstance(value, str):
            self._wrong(name, value, "a text")
        return value

    def flag(self, name: str, default: Any = _REQUIRED) -> bool:
        value = self.get(name, default)
        if not isinstance(value, bool):
            self._wrong(name, value, "true or false")
        return value

    def numbers(self, name: str, count: int | None = None, default: Any = _REQUIRED) -> tuple[float, ...]:
        return tuple(self._number(name, value) for value in self.sequence(name, default, count))

    def integers(self, name: str, count: int | None = None, default: Any = _REQUIRED) -> tuple[int, ...]:
        """Return integers of at least 1."""
        return tuple(self._whole(name, value) for value in self.sequence(name, default, count))

    def texts(self, name: str) -> tuple[str, ...]:
        values = self.sequence(name)
        if not all(isinstance(value, str) for value in values):
            self._wrong(name, values, "a list of texts")
        return tuple(values)

    def rows(self, name: str, width: int) -> list[tuple[float, ...]]:
        rows = [Section({name: row}, self.file, self.path) for row in self.sequence(name)]
        return [row.numbers(name, width) for row in rows]

    def sizes(self, name: str) -> list[tuple[float, float, float]]:
        """Return rows of length, width and height, each above 0."""
        rows = self.rows(name, 3)
        for row in rows:
            if min(row) <= 0.0:
                self._wrong(name, list(row), "a length, a width and a height above 0")
        return [(length, width, height) for length, width, height in rows]

    def sequence(self, name: str, default: Any = _REQUIRED, count: int | None = None) -> Sequence[Any]:
        """Return a non-empty list, of `count` values if given."""
        value = self.get(name, default)
        if not isinstance(value, list | tuple) or not value or (count is not None and len(value) != count):
            self._wrong(name, value, f"a list of {count}" if count else "a list")
        return [self._literal(name, part) for part in value]

    def _literal(self, name: str, part: Any) -> Any:
        return Section({name: part}, self.file, self.path).get(name)

    def _number(self, name: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            self._wrong(name, value, "a finite number")
        return float(value)

    def _whole(self, name: str, value: Any) -> int:
        if type(value) is not int or not 1 <= value <= 1_000_000:
            self._wrong(name, value, "a whole number from 1")
        return value

    def _name(self, name: str) -> str:
        return f"{self.path}.{name}" if self.path else name

    def _wrong(self, name: str, value: Any, wanted: str) -> NoReturn:
        self.refuse(f"{name} is {repr(value)[:80]}, not {wanted}", "Give the config that the model was trained with")
