"""What one measure of a vehicle does to its score: sweeps with a parameter at both ends of its kind's range.

``python docs/scripts/edits.py OUT [OUT ...] [json=FILE]``: OUT is the folder of a sweep over two values of
`attack.edit`, the lowest first. Figures are named VEHICLE/DETECTOR/WHAT; the change is of the same places, whole scenes
redrawn.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.intervals import mean_interval
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic

_PLACE = ["vehicle", "scored_by", "place"]


def edit_figures(sweep: Sweep) -> Iterator[tuple[str, dict[str, Any]]]:
    """Height and mean score at both ends, and the change of the score from the lowest to the highest.

    Raises: InputError for a sweep that is not of two edits.
    """
    rows = sweep.scored[sweep.scored["method"] == "edited"]
    heights = sweep.shapes[sweep.shapes["method"] == "edited"].set_index("task_id")["height_m"]
    rows = rows.assign(height_m=rows["task_id"].map(heights))
    edits = list(dict.fromkeys(rows["search"]))
    if len(edits) != 2:
        raise InputError(f"{len(edits)} edits", "docs/scripts/edits.py", "Give attack.edit=NAME:-1,NAME:1")
    low, high = (rows[rows["search"] == edit].set_index(_PLACE)[["score", "height_m"]].add_suffix(end)
                 for edit, end in zip(edits, ("_low", "_high")))  # fmt: skip
    for (vehicle, detector), pairs in low.join(high, how="inner").groupby(_PLACE[:2], sort=False):
        change = mean_interval(pairs["score_high"] - pairs["score_low"], list(pairs.index.get_level_values("place")))
        for end in ("low", "high"):
            mean = pairs[[f"score_{end}", f"height_m_{end}"]].mean()
            yield f"{vehicle}/{detector}/height {end}", _one(float(mean.iloc[1]), "m", None, len(pairs))
            yield f"{vehicle}/{detector}/score {end}", _one(float(mean.iloc[0]), "score", None, len(pairs))
        between = (change.low, change.high)
        yield f"{vehicle}/{detector}/change", _one(change.mean, "score", between, len(pairs))


def _one(value: float, unit: str, interval: tuple[float, float] | None, n: int) -> dict[str, Any]:
    return {"value": value, "unit": unit, "interval": interval, "n": n}


if __name__ == "__main__":
    found = {}
    for word in (word for word in sys.argv[1:] if "=" not in word):
        found |= dict(edit_figures(read_sweep(word)))
    text = json.dumps(found, indent=1) + "\n"
    for word in sys.argv[1:]:
        if word.startswith("json="):
            write_atomic(Path(word.removeprefix("json=")), text.encode())
    print(text, end="")
