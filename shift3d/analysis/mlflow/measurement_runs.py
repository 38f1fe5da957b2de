"""MLflow run of a measurement folder, such as a frontier's or a gate's: its numbers and its files."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.analysis.mlflow.client import LONGEST_NAME, attempt, experiment_of, flat, log, open_client, run_of
from shift3d.errors import InputError
from shift3d.store.frontier_table import FRONTIER_SCHEMA, machine_of, read_frontier


def mirror_measured(
    kind: str,
    folder: Path,
    files: Sequence[str],
    metrics: Mapping[str, float],
    params: Mapping[str, Any],
    uri: str,
    experiment: str,
) -> str | None:
    """Write the run "<kind>-<hash of the first file>", or update it in place.

    Different measurements are different runs, so that they can be compared; the same folder mirrored twice is one run.

    Args:
        files: file names in the folder, which become artifacts; the first is the measured table.
        params: nested plain values. uri, experiment: of the store.
    Returns: None, or the reason why MLflow could not be written.
    """

    def write() -> None:
        # Checked before anything is written: a partial run would look complete.
        missing = [name for name in files if not (folder / name).is_file()]
        if missing:
            raise InputError(f"{missing[0]} is missing", str(folder), f"Write the report of the {kind} first")
        key = hashlib.blake2b((folder / files[0]).read_bytes(), digest_size=8).hexdigest()
        client = open_client(uri)
        place = {"shift3d.folder": str(folder)}
        run = run_of(client, experiment_of(client, experiment), f"{kind}-{key}", f"shift3d.{kind}", key, **place)
        points = [(name, value, 0) for name, value in metrics.items()]
        log(client, run.info.run_id, points, run.info.start_time, flat(params))
        for name in files:
            client.log_artifact(run.info.run_id, str(folder / name))
        client.set_terminated(run.info.run_id, "FINISHED")

    return attempt(write)


_FRONTIER_FILES = ("frontier.parquet", "frontier.png", "report.html", "advice.txt")
# Columns that identify a row are not metrics.
_NAMES = ("setting", "method", "knob", "knob_name", "preset", "start", "grid", "gradient", "scenes")


def mirror_frontier(folder: Path, uri: str, experiment: str) -> str | None:
    """Mirror a frontier's folder with its table, figure, report and advice, see `mirror_measured`."""
    try:
        table = read_frontier(folder / "frontier.parquet")
    except InputError as error:
        return str(error)
    metrics = frontier_metrics(table.to_pylist())
    params = {f"machine.{_clean(name)}": value for name, value in machine_of(table).items()}
    return mirror_measured("frontier", folder, _FRONTIER_FILES, metrics, params, uri, experiment)


def frontier_metrics(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return every number of every row as ``<scenes>/<setting>/<column>``, in characters that MLflow accepts.

    Null values are left out; `pareto` is 1 or 0. If names of settings differ only in characters that MLflow refuses,
    the later settings get a number.

    Args: rows: the frontier's rows, as plain values by column.
    """
    columns = [name for name in FRONTIER_SCHEMA.names if name not in _NAMES]
    metrics: dict[str, float] = {}
    taken: set[str] = set()
    for row in rows:
        # Leave room for the longest column name and a number.
        name = plain = f"{_clean(row['scenes'])}/{_clean(row['setting'])}"[: LONGEST_NAME - 40].rstrip("/ .")
        number = 2
        while name in taken:
            name, number = f"{plain} {number}", number + 1
        taken.add(name)
        metrics |= {f"{name}/{column}": float(row[column]) for column in columns if row[column] is not None}
    return metrics


def _clean(text: str) -> str:
    """Convert text to one part of a metric's path: no separators, nothing that a path would simplify."""
    return re.sub(r"[^\w\-. ]", "_", text).strip(" .") or "_"


GATE_EXPERIMENT = "shift3d-gate"
_GATE_FILES = ("verdict.json", "gate.parquet", "gate.html")


def mirror_gate(folder: Path, uri: str) -> str | None:
    """Write the run of a gate's folder; the same suite, weights and previous release update one run in place.

    Returns None, or the reason why MLflow could not be written.
    """
    verdict = json.loads((folder / _GATE_FILES[0]).read_bytes())
    metrics = {"worse": float(verdict["worse"])}
    for measure in verdict["measures"]:
        title = f"{measure['role']}/{measure['name']}"
        metrics |= {f"{title}/{what}": measure[what] for what in ("before", "after", "change", "p_value")}
    metrics |= {f"{role}/lost": counts["lost"] for role, counts in verdict["objects"].items()}
    return mirror_measured("gate", folder, _GATE_FILES, metrics, verdict["facts"], uri, GATE_EXPERIMENT)
