"""What to say of a sweep in which no vehicle found a place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["nothing_placed"]


def nothing_placed(scores: pd.DataFrame, settings: Mapping[str, Any]) -> str | None:
    """That nothing fitted, what a place had to be, and which settings to widen; None where some vehicle found one.

    Args:
        scores: the table of ``final/``. settings: of the sweep's first task.
    """
    if scores.empty or not scores["status"].eq("no_placement").all():
        return None
    tasks = scores["task_id"].nunique()
    which = "its one task has" if tasks == 1 else f"all {tasks} tasks have"
    place = settings["attack"]["placement"]
    return (
        f"no vehicle found a place: {which} no score. Each tried {counted(place['attempts'], 'place')} of at least "
        f"{counted(place['min_object_points'], 'point')}, {place['min_range_m']:g} to {place['max_range_m']:g} m away, "
        f"that touch the scene ({place['contact_m']:g} m) and nothing in it ({place['overlap_m']:g} m). Widen "
        "attack.placement.min_object_points, .min_range_m, .max_range_m or .attempts, or take other scenes"
    )
