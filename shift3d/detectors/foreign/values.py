"""Sections of a config, read by name: what is missing or of another kind is an error that says where."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from shift3d.errors import InputError

_REQUIRED: Any = object()
DELETE = "_delete_"
"""In a table of mmdetection3d's: nothing of the table under it is kept."""


@dataclass(frozen=True)
class Unread:
    """What a config says at a line in a way that only running it would tell."""

    text: str
    file: str
    line: int


def merged(under: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A config over its base: tables are merged, all else is replaced."""
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
    """A table of a config. file: named in errors. path: what leads to it, with dots."""

    values: Mapping[str, Any]
    file: str
    path: str = ""

    def refuse(self, what: str, remedy: str = "Give a model that docs/guides/detectors.md lists") -> NoReturn:
        """Raise InputError: this section describes a model that is not covered."""
        raise InputError(f"{self.path}: {what}" if self.path else what, self.file, remedy)

    def has(self, name: str) -> bool:
        return self.values.get(name) is not None

    def get(self, name: str, default: Any = _REQUIRED) -> Any:
        """A value as it is; the default where it is missing. Raises InputError: no such value, or no literal."""
        value = self.values.get(name, default)
        if value is _REQUIRED:
            self.refuse(f"{name} is missing", "Give the config that the model was trained with")
        if isinstance(value, Unread):
            what = f"{self._name(name)} is no literal: {value.text}"
            raise InputError(what, f"{value.file}, line {value.line}", "Write its value there: configs are never run")
        return value

    def expect(self, name: str, wanted: Any, default: Any = _REQUIRED) -> None:
        """Refuse another value than the one wanted, or, of a tuple, than one of those."""
        value, known = self.get(name, default), wanted if isinstance(wanted, tuple) else (wanted,)
        if value not in known:
            self.refuse(f"{name} is {repr(value)[:80]}, not {' or '.join(repr(one) for one in known)}")

    def absent(self, *names: str) -> None:
        """Refuse any of these, where it is there: a part that is not covered."""
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
        """A whole number, 1 or more."""
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

    def wholes(self, name: str, count: int | None = None, default: Any = _REQUIRED) -> tuple[int, ...]:
        """Whole numbers, 1 or more each."""
        return tuple(self._whole(name, value) for value in self.sequence(name, default, count))

    def texts(self, name: str) -> tuple[str, ...]:
        values = self.sequence(name)
        if not all(isinstance(value, str) for value in values):
            self._wrong(name, values, "a list of texts")
        return tuple(values)

    def rows(self, name: str, width: int) -> list[tuple[float, ...]]:
        rows = [Section({name: row}, self.file, self.path) for row in self.sequence(name)]
        return [row.numbers(name, width) for row in rows]

    def sequence(self, name: str, default: Any = _REQUIRED, count: int | None = None) -> Sequence[Any]:
        """A list that is not empty, of `count` values."""
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
