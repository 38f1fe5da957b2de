"""Settings that are texts: a number that is given for one is a name (an epoch, a frame, a folder), and stays as it was
written.

Hydra and YAML read ``vehicle.checkpoint=2000`` as a number, ``vehicle.name=1e5`` as 100000.0, and the quotes that would
say otherwise are the shell's.
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


def _as_text(value: object) -> object:
    """A whole number as the text that it was; what else there is the schema judges."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


Text = Annotated[str, BeforeValidator(_as_text)]
"""A text setting of the schema."""


def _refuse_number(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool):
        remedy = {"remedy": 'Put names in quotes, as in ["000008", "000010"]'}
        raise PydanticCustomError("number", "a number, which YAML makes of a name: 8 of 010", remedy)
    return value


Name = Annotated[str, BeforeValidator(_refuse_number)]
"""A name of the schema in a list, where YAML would take its digits for a number: 010 for 8, 2023_10_05 for 20231005."""


@functools.cache
def text_settings(model: type[BaseModel]) -> frozenset[str]:
    """Paths of the settings of a schema that are texts or lists of texts."""
    found = set()
    for name, field in model.model_fields.items():
        key = field.alias or name
        for kind in _kinds(field.annotation):
            if kind is str:
                found.add(key)
            elif isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= {f"{key}.{inner}" for inner in text_settings(kind)}
    return frozenset(found)


def _kinds(annotation: Any) -> list[Any]:
    """The types that a value may be of, lists by their items."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Annotated:
        return _kinds(arguments[0])
    if origin in (typing.Union, types.UnionType, list):
        return [kind for argument in arguments for kind in _kinds(argument)]
    return [annotation]


def quoted(override: str, texts: Collection[str]) -> str:
    """An override with the numbers in quotes where its setting is one of some texts."""
    key, equals, value = override.partition("=")
    if key.lstrip("+") not in texts or "'" in value or '"' in value:
        return override
    return f"{key}{equals}{_NUMBER.sub(lambda number: repr(number[0]), value)}"
