"""Results of a benchmark run: records, their file, and the printed tables.

The file is one JSON object: name to {"value", "unit", "of"} and, if known, "low" and "high" (quartiles) and "note". It
has no entry for a number that was not measured.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.timing import Timing

from shift3d.analysis.tables.table import Table
from shift3d.store.atomic import write_atomic

__all__ = ["GOALS", "Record", "Results", "comparison", "read_results", "summary"]

Record = dict[str, Any]

GOALS: dict[str, tuple[str, float]] = {
    "render_cold_ratio": (">=", 300.0),
    "render_warm_ratio": (">=", 1000.0),
    "attack_step_ratio": (">=", 300.0),
    "limit_ratio": ("<=", 3.0),
    "scene_growth_ratio": ("<=", 1.3),
    "worker_peak_mb": ("<=", 1500.0),
    "sweep_overhead_us": ("<=", 250.0),
    "hydra_ray_launcher_ratio": (">=", 300.0),
    "ray_tune_ratio": (">=", 50.0),
    "scaling_two_workers": (">=", 1.9),
    "plan_million_s": ("<=", 10.0),
    "plan_million_peak_mb": ("<=", 1500.0),
    "resume_million_s": ("<=", 15.0),
    "reread_million_s": ("<=", 15.0),
}
"""Claims of the project. A run that misses a claim reports it and does not fail: a benchmark measures."""


class Results:
    """Records of one run, in the order of their measurement.

    on_record: called with a line for every record, so that a run of minutes shows progress. condition: a fact about the
    whole run that every record states, such as a quick run.
    """

    def __init__(self, on_record: Callable[[str], None] = lambda line: None, condition: str = "") -> None:
        self.records: dict[str, Record] = {}
        self._on_record = on_record
        self._condition = f" ({condition})" if condition else ""

    def add(
        self,
        name: str,
        value: float,
        unit: str,
        of: str,
        low: float | None = None,
        high: float | None = None,
        note: str = "",
    ) -> None:
        """Add one record.

        Args:
            value, low, high: the number and its quartiles.
            of: the measured subject; the same in every run of the same benchmark, so that runs can be compared.
            note: facts of this run alone (counts, sums).

        Raises: ValueError for a name that exists already, or a number that is not finite.
        """
        if name in self.records:
            raise ValueError(f"{name} was measured twice")
        record: Record = {"value": _rounded(name, value), "unit": unit, "of": of + self._condition}
        for key, quartile in (("low", low), ("high", high)):
            if quartile is not None:
                record[key] = _rounded(name, quartile)
        if note:
            record["note"] = note
        self.records[name] = record
        self._on_record(f"{name} {_number(record['value'])} {unit}" + (f" ({note})" if note else ""))

    def time(self, name: str, timing: Timing, of: str, note: str = "") -> None:
        """Add a median time with its quartiles."""
        self.add(name, timing.median, "ms", of, timing.low, timing.high, note)

    def ratio(self, name: str, above: Timing, below: Timing, of: str, note: str = "") -> None:
        """Add a ratio of medians; low and high are the extremes that the quartiles allow."""
        spent = f"{_number(above.median)} / {_number(below.median)} ms"
        note = f"{spent}; {note}" if note else spent
        low, high = above.low / below.high, above.high / below.low
        self.add(name, above.median / below.median, "ratio", of, low, high, note)

    def write(self, path: Path) -> None:
        """Write the file, whole or not at all."""
        text = json.dumps(self.records, indent=1, allow_nan=False)
        write_atomic(path, (text + "\n").encode())


def _rounded(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}")
    return float(f"{float(value):.6g}")


def read_results(path: Path) -> dict[str, Record]:
    """Read the records of a file. Raises ValueError for a file of another format."""
    try:
        records = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not isinstance(records, dict):
        raise ValueError(f"{path}: not a file of benchmark results")
    for name, record in records.items():
        if not isinstance(record, dict) or not {"value", "unit", "of"} <= record.keys():
            raise ValueError(f"{path}: {name} lacks value, unit or of")
    return records


def summary(records: Mapping[str, Record]) -> str:
    """Return the table of one run with the goals, if any, and below it the subject of each measurement."""
    lines = []
    for name, record in records.items():
        quartiles = f"{_number(record['low'])} .. {_number(record['high'])}" if "low" in record else ""
        lines.append([name, _number(record["value"]), quartiles, record["unit"], _goal(name, record["value"])])
    table = Table("Measured", ["name", "value", "quartiles", "unit", "goal"], lines)
    legend = [f"{name}: {record['of']}" for name, record in records.items()]
    return "\n".join([str(table), "", *legend])


def _goal(name: str, value: float) -> str:
    if name not in GOALS:
        return ""
    relation, bound = GOALS[name]
    reached = value >= bound if relation == ">=" else value <= bound
    return f"{relation} {_number(bound)}" + ("" if reached else " MISSED")


def comparison(old: Mapping[str, Record], new: Mapping[str, Record]) -> str:
    """Return old and new value and their ratio, new / old. A star marks a pair with different measured subjects."""
    lines, starred = [], False
    for name in dict.fromkeys([*old, *new]):
        before, after = old.get(name), new.get(name)
        ratio = "-"
        if before and after and before["value"]:
            ratio = _number(after["value"] / before["value"])
        differs = bool(before and after and (before["of"], before["unit"]) != (after["of"], after["unit"]))
        starred |= differs
        unit = (after or before or {})["unit"]
        values = [_number(record["value"]) if record else "-" for record in (before, after)]
        lines.append([name + ("*" if differs else ""), *values, unit, ratio])
    table = Table("Against an earlier run", ["name", "old", "new", "unit", "new / old"], lines)
    return str(table) + ("\n* not measured of the same thing in both runs" if starred else "")


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
