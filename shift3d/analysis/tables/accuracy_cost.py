"""What a sweep's accuracy cost, and what the next preset up or down would cost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LADDER", "MEASURED", "accuracy_cost", "measured_presets"]

LADDER = ("draft", "standard", "reference")
"""Presets by rising accuracy and cost. `paper` costs more than its accuracy is worth and stands beside them."""
MEASURED = Path(__file__).resolve().parent.parent / "measured" / "presets.json"
"""The presets' rows of a measured frontier: `docs/scripts/shipped.py` writes them from its folder."""
_ERRORS = ("missed_hits", "false_hits", "wrong_surface")


def measured_presets(folder: Path | None = None) -> tuple[pd.DataFrame, str]:
    """The presets' rows on streets of this installation's frontier, or of the one that ships; and whose they are.

    folder: where a frontier was written, default outputs/frontier of the working directory.
    Raises: InputError for a frontier file that is there and cannot be read.
    """
    import pandas as pd

    from shift3d.store.frontier_table import FRONTIER_SCHEMA, read_frontier

    file = (folder or Path("outputs") / "frontier") / "frontier.parquet"
    if file.is_file():
        rows, whose = read_frontier(file).to_pandas(), "this machine's frontier"
    else:
        rows = pd.read_json(MEASURED).reindex(columns=FRONTIER_SCHEMA.names)
        whose = "the frontier that ships (another machine; make frontier measures this one)"
    rows = rows[rows["preset"].notna() & (rows["scenes"] == "street")]
    return rows.drop_duplicates("preset").set_index("preset"), whose


def accuracy_cost(scores: pd.DataFrame, timings: pd.DataFrame, presets: pd.DataFrame, whose: str) -> str:
    """A paragraph an accuracy preset. scores, timings: of ``final/``. presets, whose: see `measured_presets`."""
    lines = ["What accuracy cost"]
    for name, rows in scores.groupby("accuracy", sort=True):
        spent = timings[timings["task_id"].isin(rows["task_id"])]
        lines.append(f"{name}: {_audited(rows)} {_spent(spent)}")
        lines += [f"  {line}" for line in _neighbours(str(name), presets)]
    if len(presets):
        lines.append(f"  (ratios and errors by {whose})")
    return "\n".join(lines)


def _audited(rows: pd.DataFrame) -> str:
    """What the audits found, each object counted once."""
    rows = rows[rows["audited_beams"].notna()].drop_duplicates(["task_id", "method", "replicate"])
    if not len(rows):
        return "no beam was audited."
    beams, hits = int(rows["audited_beams"].sum()), int(rows["audited_hits"].sum())
    missed, false, wrong = (int(rows[name].sum()) for name in _ERRORS)
    depth = 1e3 * float(rows["depth_error_max_m"].max())
    return (
        f"{counted(beams, 'beam')} of {counted(len(rows), 'object')} rendered again at reference accuracy: "
        f"of {hits} true hits {missed} missed, {wrong} on another surface, {false} false; "
        f"depth error at most {depth:.2g} mm."
    )


def _spent(timings: pd.DataFrame) -> str:
    """Time that rendering and auditing took of a task's."""
    stages = timings.groupby("stage")["milliseconds"].sum()
    tasks, total = timings["task_id"].nunique(), float(stages.get("total", 0.0))
    if not tasks or not total:
        return "No times."
    shares = [
        f"{name} {stages[name] / total:.0%}" for name in ("render", "detector", "backward", "audit") if name in stages
    ]
    return f"A task took {total / tasks / 1e3:.1f} s: {', '.join(shares)}."


def _neighbours(name: str, presets: pd.DataFrame) -> list[str]:
    """What the presets next to this one would cost."""
    if name not in presets.index:
        return []
    if name in LADDER:
        place = LADDER.index(name)
        next_to = [*LADDER[max(0, place - 1) : place], *LADDER[place + 1 : place + 2]]
    else:
        next_to = ["standard"]
    here = presets.loc[name]
    return [_compared(other, here, presets.loc[other]) for other in next_to if other in presets.index]


def _compared(name: str, here: pd.Series, there: pd.Series) -> str:
    import pandas as pd

    ratio = float(there["ms_median"]) / float(here["ms_median"])
    steps = [pd.to_numeric(row["step_ms_median"]) for row in (there, here)]
    loop = f" ({steps[0] / steps[1]:.2g} x an attack step's)" if all(pd.notna(step) for step in steps) else ""
    lost_here, lost_there = (sum(float(row[error]) for error in _ERRORS) for row in (here, there))
    return (
        f"{name} would take {ratio:.2g} x the rendering time{loop}: depth error p99 "
        f"{1e3 * float(there['depth_p99_m']):.2g} mm for {1e3 * float(here['depth_p99_m']):.2g} mm, hits lost or wrong "
        f"{lost_there:.2%} for {lost_here:.2%}"
    )
