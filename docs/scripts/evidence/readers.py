"""Readers of figures from a measurement's folder: JSON, Parquet, or the printed output of its commands.

``json``: a file of {name: {value, ...}} or {name: number}; ``only`` is a regular expression for names, ``of`` selects a
part of the file, ``name`` is a prefix for the names of numbers.
``rows``: a Parquet file; each row that ``where`` selects gives a figure for each of ``values``: its name, and the
columns or expressions of value, low, high and n. Columns of the row fill in ``name``.
``printed``: a regular expression over the output. Its groups are the figures; groups of ``name`` name them.
``count``: a regular expression over the output; the number of its matches is the figure ``name``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scripts.evidence.record import figure

Figures = dict[str, dict[str, Any]]


def read_figures(folder: Path, output: str, specs: Sequence[Mapping[str, Any]]) -> Figures:
    """Read every figure of a finished measurement.

    Raises: ValueError if a reader finds nothing, or if a name occurs twice.
    """
    found: Figures = {}
    for spec in specs:
        kind = next(name for name in _READERS if name in spec)
        some = dict(_READERS[kind](folder, output, spec))
        if not some or some.keys() & found.keys():
            raise ValueError(f"{spec}: {'twice' if some else 'nothing found'}")
        found |= some
    return found


def _json(folder: Path, output: str, spec: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    found = json.loads((folder / spec["json"]).read_text(encoding="utf-8"))
    for name, one in (found[spec["of"]] if "of" in spec else found).items():
        if not re.search(spec.get("only", ""), name):
            continue
        if isinstance(one, Mapping) and "value" in one:
            low, high = one.get("interval") or (one.get("low"), one.get("high"))
            yield name, figure(one["value"], one.get("unit", ""), low, high, one.get("n"))
        elif isinstance(one, int | float):
            yield spec.get("name", "") + name, figure(one, spec.get("unit", ""))


def _rows(folder: Path, output: str, spec: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    import pandas as pd

    rows = pd.read_parquet(folder / spec["rows"])
    for column, value in spec.get("where", {}).items():
        rows = rows[rows[column].isna() if value is None else rows[column].isin(np.atleast_1d(value))]
    for what, columns in spec["values"].items():
        columns_of = [rows.eval(column) for column in columns]
        for row, *numbers in zip(rows.to_dict("records"), *columns_of):
            value, low, high, n = [*(None if pd.isna(one) else one for one in numbers), None, None, None][:4]
            if value is not None:
                value = int(value) if isinstance(value, bool) else value
                n = None if n is None else int(n)
                yield spec["name"].format(**row) + what, figure(value, spec.get("unit", ""), low, high, n)


def _printed(folder: Path, output: str, spec: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for match in re.finditer(spec["printed"], output, flags=re.MULTILINE):
        groups = match.groupdict()
        prefix = groups.pop("name", None)
        for name, text in groups.items():
            number = float(text.replace(",", ""))
            value = int(number) if number.is_integer() and "." not in text else number
            yield f"{prefix.strip()}/{name}" if prefix else name, figure(value, spec.get("unit", ""))


def _count(folder: Path, output: str, spec: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    yield spec["name"], figure(len(re.findall(spec["count"], output, flags=re.MULTILINE)), spec.get("unit", ""))


_READERS = {"json": _json, "rows": _rows, "printed": _printed, "count": _count}
