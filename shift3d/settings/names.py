"""Text settings: digits given for an epoch, frame or folder stay a text exactly as written.

Without this, Hydra and YAML read ``vehicle.checkpoint=2000`` as a number and ``vehicle.name=1e5`` as 100000.0, and
refuse ``scenes.root=/data/día=1``; the shell removes quotes that would prevent it.
"""

from __future__ import annotations

import functools
import re
import types
import typing
from collections.abc import Collection
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator
from pydantic_core import PydanticCustomError

_NUMBER = re.compile(r"(?<![^\s=,\[])[-+]?[\d._]+(?:[eE][-+]?\d+)?(?![^\s,\]])")

_WORD = re.compile(r"[^,\[\]]+")  # of a list of values
_QUOTED_ALONE = re.compile(r"[^\w\s/\\+.$%*@?|:-]", re.ASCII)  # letters with accents, =, &, #: frequent in paths
_STRUCTURE = re.compile(r"[(){}]")  # functions, dictionaries, interpolations, and Hydra's escapes of brackets


def _as_text(value: object) -> object:
    """Convert an integer to text; the schema checks all other values."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Text = Annotated[str, BeforeValidator(_as_text)]
"""Type of a text setting in the schema."""


def _refuse_number(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool):
        remedy = {"remedy": 'Put names in quotes, as in ["000008", "000010"]'}
        raise PydanticCustomError("number", "a number, which YAML makes of a name: 8 of 010", remedy)
    return value


Name = Annotated[str, BeforeValidator(_refuse_number)]
"""Type of a name in a list. YAML reads unquoted digits as a number: 010 as 8, 2023_10_05 as 20231005."""


@functools.cache
def text_setting_paths(model: type[BaseModel]) -> frozenset[str]:
    """Return the paths of a schema's settings that are texts or lists of texts."""
    found = set()
    for name, field in model.model_fields.items():
        key = field.alias or name
        for kind in _kinds(field.annotation):
            if kind is str:
                found.add(key)
            elif isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= {f"{key}.{inner}" for inner in text_setting_paths(kind)}
    return frozenset(found)


def _kinds(annotation: Any) -> list[Any]:
    """List the types that an annotation allows; a list type counts as its item types."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _kinds(arguments[0])
    if origin in (typing.Union, types.UnionType, list):
        return [kind for argument in arguments for kind in _kinds(argument)]
    return [annotation]


def quoted(override: str, texts: Collection[str]) -> str:
    """Quote numbers, and words that Hydra reads in quotes alone, in an override if its setting is in `texts`."""
    key, equals, value = override.partition("=")
    if key.lstrip("+") not in texts or "'" in value or '"' in value:
        return override
    return f"{key}{equals}{_WORD.sub(lambda word: _quoted_word(word[0]), value)}"


def _quoted_word(word: str) -> str:
    if _QUOTED_ALONE.search(word) and not _STRUCTURE.search(word):
        return f'"{word}"'
    return _NUMBER.sub(lambda number: repr(number[0]), word)
