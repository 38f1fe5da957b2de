"""One MLflow run a measured frontier: every setting's numbers, and the files of its folder."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.analysis.mlflow.measured import mirror_measured
from shift3d.errors import InputError
from shift3d.store.frontier_table import FRONTIER_SCHEMA, machine_of, read_frontier

_FILES = ("frontier.parquet", "frontier.png", "report.html", "advice.txt")
# What names a row is no metric of it.
_NAMES = ("setting", "method", "knob", "knob_name", "preset", "start", "grid", "gradient", "scenes")
_LONGEST_NAME = 250  # MLflow's own limit


def mirror_frontier(folder: Path, uri: str, experiment: str) -> str | None:
    """Write the run "frontier-<hash of frontier.parquet>", or write it again in place.

    The hash is that of the measured table: another measurement is another run, so that they can be compared, and the
    same folder mirrored twice is one.

    Args:
        folder: with frontier.parquet, frontier.png, report.html and advice.txt, which become artifacts.
        uri, experiment: of the store.

    Returns:
        None, or why MLflow could not be written.
    """
    try:
        table = read_frontier(folder / "frontier.parquet")
    except InputError as error:
        return str(error)
    metrics = frontier_metrics(table.to_pylist())
    params = {f"machine.{_clean(name)}": value for name, value in machine_of(table).items()}
    return mirror_measured("frontier", folder, _FILES, metrics, params, uri, experiment)


def frontier_metrics(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Every number of every row as ``<scenes>/<setting>/<column>``, in characters that MLflow takes.

    What is null is left out; `pareto` is 1 or 0. Of settings whose names differ only in characters that MLflow does
    not take, the later ones get a number.

    Args:
        rows: the frontier's, as plain values by column.
    """
    columns = [name for name in FRONTIER_SCHEMA.names if name not in _NAMES]
    metrics: dict[str, float] = {}
    taken: set[str] = set()
    for row in rows:
        # Room for the longest column's name and a number.
        name = plain = f"{_clean(row['scenes'])}/{_clean(row['setting'])}"[: _LONGEST_NAME - 40].rstrip("/ .")
        number = 2
        while name in taken:
            name, number = f"{plain} {number}", number + 1
        taken.add(name)
        metrics |= {f"{name}/{column}": float(row[column]) for column in columns if row[column] is not None}
    return metrics


def _clean(text: str) -> str:
    """Text as one part of a metric's path: no separators, nothing that a path would simplify away."""
    return re.sub(r"[^\w\-. ]", "_", text).strip(" .") or "_"
