"""Writes the shipped files of measured numbers again.

``python docs/scripts/shipped.py presets FOLDER``: rows of the presets, from the frontier measured in FOLDER.
``python docs/scripts/shipped.py task_parts MACHINE OUT ...``: times of the parts of a task, from finished sweeps of one
accuracy preset; MACHINE describes their machine in words.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from shift3d.analysis.forecast import SHIPPED, TaskPartTimes
from shift3d.analysis.results import read_sweep
from shift3d.analysis.tables.accuracy.cost import MEASURED
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic
from shift3d.store.frontier_table import read_frontier
from shift3d.wording import counted

__all__ = ["main", "measured_parts"]

_STEP, _DESCENT = ("render", "constraints"), ("detector", "backward")
_SCORED_BY = "scored_by_"


def measured_parts(scores: pd.DataFrame, timings: pd.DataFrame, source: str) -> TaskPartTimes:
    """Compute part times from the tables of finished sweeps, concatenated. source: name of these sweeps.

    Raises:
        InputError: the sweeps have several accuracy presets.
    """
    whose = scores.drop_duplicates("task_id")[["task_id", "mode", "detector", "accuracy"]]
    rows = timings.merge(whose, on="task_id")
    accuracies = sorted(whose["accuracy"].unique())
    if len(accuracies) != 1:
        raise InputError(f"are of the accuracies {', '.join(accuracies)}", "sweeps", "Give sweeps of one")
    searches = rows["method"].eq("adversarial") & rows["stage"].isin([*_STEP, *_DESCENT])
    search, objects, rest = rows[searches], rows[~searches], rows[~rows["stage"].isin([*_STEP, *_DESCENT])]
    others = rest["stage"].str.startswith(_SCORED_BY)
    once = rest[~others & ~rest["stage"].isin(["total", "transfers", "effects_once"])]
    by_others = rest[others].assign(detector=rest[others]["stage"].str.removeprefix(_SCORED_BY))
    scored = pd.concat([objects[objects["stage"] == "detector"], by_others]).assign(stage="detector")
    return TaskPartTimes(
        source=source,
        accuracy=accuracies[0],
        once_ms=_mean(once, "mode", whose.groupby("mode").size().to_dict()),
        step_ms=_mean(search[search["stage"].isin(_STEP)], "mode"),
        scored_ms=_mean(objects[objects["stage"].isin(_STEP)], "mode"),
        descent_ms=_mean(search[search["stage"].isin(_DESCENT)], "detector"),
        score_ms=_mean(scored, "detector"),
        placement_ms=round(float(rest.loc[rest["stage"] == "placement", "milliseconds"].mean()), 1),
    )


def _mean(rows: pd.DataFrame, by: str, calls: dict[str, int] | None = None) -> dict[str, float]:
    """Return milliseconds per call of all stages together: the sum of each stage's mean."""
    found = {}
    for name, some in rows.groupby(by):
        stages = some.groupby("stage")[["milliseconds", "calls"]].sum()
        number = calls[str(name)] if calls else stages["calls"]
        found[str(name)] = round(float((stages["milliseconds"] / number).sum()), 1)
    return found


def main(arguments: Sequence[str]) -> None:
    """Write the numbers that the first argument names, from the folders that follow it."""
    match list(arguments):
        case ["presets", folder]:
            rows = read_frontier(Path(folder) / "frontier.parquet").to_pandas()
            text = rows[rows["preset"].notna()].to_json(orient="records", indent=2, double_precision=15)
            write_atomic(MEASURED, f"{text}\n".encode())
        case ["task_parts", machine, *folders] if folders:
            sweeps = [read_sweep(folder) for folder in folders]
            scores = pd.concat([sweep.scored for sweep in sweeps])
            tasks = Counter[str]()
            for sweep in sweeps:
                tasks[sweep.plan.sweep] += sweep.scored["task_id"].nunique()
            source = ", ".join([*(f"{counted(number, 'task')} of {name}" for name, number in tasks.items()), machine])
            parts = measured_parts(scores, pd.concat([sweep.timings for sweep in sweeps]), source)
            write_atomic(SHIPPED, f"{json.dumps(asdict(parts), indent=2)}\n".encode())
        case _:
            raise SystemExit(__doc__)


if __name__ == "__main__":
    main(sys.argv[1:])
