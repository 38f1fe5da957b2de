"""Cost of a sweep's accuracy, its numerical diagnostics, and the cost of other presets."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pandas as pd

from shift3d.analysis.tables.accuracy.frontier import meanings, settings_table
from shift3d.analysis.tables.table import Table
from shift3d.errors import InputError
from shift3d.store.frontier_table import FRONTIER_SCHEMA, read_frontier
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.wording import counted

_BASELINE = ["method", "dataset", "scene", "vehicle", "detector", "accuracy", *POSE_COLUMNS]


def _objects(scores: pd.DataFrame) -> pd.DataFrame:
    """Select one row per object, whatever the number of detectors. A baseline that tasks share is rendered once."""
    rows = scores.drop_duplicates(["task_id", "method", "replicate"])
    shared = rows[_BASELINE].assign(effects=rows["effects"].map("+".join)).duplicated()
    return rows[~(shared & rows["method"].eq("baseline"))]


def diagnostics(scores: pd.DataFrame) -> str:
    """Describe the numerical diagnostics of a sweep's rows; each object counts once."""
    rows = _objects(scores[scores["max_residual_m"].notna()])
    if not len(rows):
        return "Numerics: no object was rendered."
    non_finite, unresolved = (int(rows[name].sum()) for name in ("non_finite", "unresolved_beams"))
    text = (
        f"Numerics over {counted(len(rows), 'object')}: {non_finite} non-finite values, {unresolved} unresolved beams; "
        f"at hits the distance field is at most {1e3 * float(rows['max_residual_m'].max()):.2g} mm"
    )
    searched = rows[rows["method"] == "adversarial"]
    if searched["grazing_gradient"].notna().any():
        text += (
            f", and its slope along the beam is at least {float(scores['least_slope'].min()):.2g}; grazing beams carry "
            f"{float(searched['grazing_gradient'].mean()):.0%} of the gradient"
        )
    return f"{text}."


# Preset rows of a measured frontier; `docs/scripts/shipped.py` writes them from the frontier's folder.
MEASURED = Path(__file__).resolve().parents[2] / "measured" / "presets.json"
_ERRORS = ("missed_hits", "false_hits", "wrong_surface")
_HEADERS = ("time", "x paper", "missed", "wrong", "false", "p99", "max", "cosine", "step", "AUC")


def measured_presets(folder: Path | None = None) -> tuple[pd.DataFrame, str]:
    """Load the presets' street rows of the local frontier, or of the shipped one. Returns the rows and their origin.

    folder: folder of the local frontier, default outputs/frontier of the working directory. A local frontier that is
    unreadable, has other scenes or lacks a preset is named and ignored, so that a sweep does not end in an error.
    """
    file = (folder or Path("outputs") / "frontier") / "frontier.parquet"
    shipped = _of_presets(pd.read_json(MEASURED).reindex(columns=FRONTIER_SCHEMA.names))
    if file.is_file():
        with contextlib.suppress(InputError):
            own = _of_presets(read_frontier(file).to_pandas())
            if set(shipped.index) <= set(own.index):
                return own, "this machine's frontier"
        why = f"{file} cannot be read or lacks a preset on streets: run shift3d frontier"
        return shipped, f"the shipped frontier ({why})"
    return shipped, "the shipped frontier (of another machine; shift3d frontier measures this one)"


def _of_presets(rows: pd.DataFrame) -> pd.DataFrame:
    rows = rows[rows["preset"].notna() & (rows["scenes"] == "street")]
    return rows.drop_duplicates("preset").set_index("preset")


def preset_table(folder: Path | None = None) -> Table:
    """Build the table of cost and errors of each preset, see `measured_presets`."""
    presets, whose = measured_presets(folder)
    return settings_table(presets.reset_index(), f"Cost and errors of the presets, by {whose}", "preset", _HEADERS)


def preset_meanings() -> dict[str, str]:
    """Return the meanings of the columns of `preset_table`."""
    return meanings(_HEADERS)


def accuracy_cost(scores: pd.DataFrame, timings: pd.DataFrame) -> list[str]:
    """Describe audit results and time by accuracy preset, one line each. scores, timings: tables of ``final/``."""
    by_preset = scores.groupby("accuracy", sort=True)
    return [
        f"{name}: {_audited(rows)} {_spent(timings[timings['task_id'].isin(rows['task_id'])])}"
        for name, rows in by_preset
    ]


def _audited(rows: pd.DataFrame) -> str:
    """Describe the audit results; each object counts once."""
    rows = _objects(rows[rows["audited_beams"].notna()])
    if not len(rows):
        return "the audit rendered no beam."
    beams, hits = int(rows["audited_beams"].sum()), int(rows["audited_hits"].sum())
    missed, false, wrong = (int(rows[name].sum()) for name in _ERRORS)
    depth = 1e3 * float(rows["depth_error_max_m"].max())
    return (
        f"{counted(beams, 'beam')} of {counted(len(rows), 'object')} rendered again at reference accuracy: "
        f"of {hits} true hits, {missed} missed and {wrong} on another surface; {false} false hits; "
        f"depth error at most {depth:.2g} mm."
    )


def _spent(timings: pd.DataFrame) -> str:
    """Describe the time of a task by stage, longest first; stages below 1 % are summed as `other`."""
    stages = timings.groupby("stage")["milliseconds"].sum().sort_values(ascending=False)
    tasks, total = timings["task_id"].nunique(), float(stages.get("total", 0.0))
    if not tasks or not total:
        return "No timings."
    parts = stages.drop("total") / total
    shares = [f"{str(name).replace('_', ' ')} {share:.0%}" for name, share in parts[parts >= 0.01].items()]
    other = 1.0 - float(parts[parts >= 0.01].sum())
    shares += [f"other {other:.0%}"] if other >= 0.01 else []
    return f"A task took {total / tasks / 1e3:.1f} s: {', '.join(shares)}."
