"""What an object of a sweep is: a vehicle at a place; tasks of several modes, lambdas or alphas share its baseline."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

PLACE = ["baseline_x_m", "baseline_y_m", "baseline_yaw_rad"]
"""Where a row's vehicle was placed: the same to the bit under any effects and beams."""


def with_places(scores: pd.DataFrame) -> pd.DataFrame:
    """Rows of ``scores`` with `PLACE`, that of their task's baseline, NaN without one."""
    base = scores[scores["method"] == "baseline"].drop_duplicates("task_id").set_index("task_id")
    places = {name: scores["task_id"].map(base[name.removeprefix("baseline_")]) for name in PLACE}
    return scores.assign(**places)


def one_baseline(rows: pd.DataFrame, same: Sequence[str]) -> pd.DataFrame:
    """The rows without a baseline that came before. same: columns that tell an object from others."""
    return rows[~(rows["method"].eq("baseline") & rows.duplicated(["method", *same]))]
