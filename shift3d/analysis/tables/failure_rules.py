"""Failure rules of a sweep: found on a part of its objects and tested on the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from shift3d.analysis.statistics.intervals import Interval, difference_interval
from shift3d.analysis.tables.table import Table, interval_text
from shift3d.errors import InputError
from shift3d.evaluation.failure_rules import Condition, FailureRule, aspect_deg, find_rules
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.analysis.results import Sweep

# Quantities that a rule can use: wording, unit, factor and digits.
_QUANTITIES = {
    "range_m": ("range", " m", 1.0, 0),
    "aspect_deg": ("angle to the line of sight", "°", 1.0, 0),
    "tilt_deg": ("tilt", "°", 1.0, 1),
    "length_m": ("length", " cm", 100.0, 0),
    "width_m": ("width", " cm", 100.0, 0),
    "height_m": ("height", " cm", 100.0, 0),
    "clearance_m": ("ground clearance", " cm", 100.0, 0),
}
_SIZES = ("length_m", "width_m", "height_m", "clearance_m")
# With fewer scenes chance differences are confirmed too often: at 4 scenes, a third of the rules found in noise.
_LEAST_SCENES = 8
_METHODS = ("baseline", "random", "random_budget", "edited", "adversarial")


@dataclass(frozen=True)
class TriedRule:
    """Rule with the difference in mean score between matched and other objects, by group of objects.

    Objects that an earlier rule of the list matches are on neither side. objects: number of matched objects in the
    group where the rule was found. tried: difference by name of each non-empty group; None if one side is empty.
    """

    rule: FailureRule
    objects: int
    found: Interval
    tried: Mapping[str, Interval | None]

    @property
    def confirmed(self) -> bool:
        """True if there is a test group, and the interval lies below zero in every test group."""
        return len(self.tried) > 0 and all(found is not None and found.high < 0 for found in self.tried.values())


def failure_rules(objects: pd.DataFrame) -> list[TriedRule]:
    """Find rules on every other scene and every other vehicle for the attacked detector, and test them on the rest.

    The test groups are the same vehicles in the other scenes, the other vehicles, and the scores that other detectors
    give to all of these. Each rule is tested on the objects that no earlier rule matches.

    objects: see `rule_objects`; objects that `left_out` counts are excluded.
    Raises: InputError: there are too few scenes to find rules on some and test them on others.
    Source: our choice.
    """
    known = _known(objects)
    objects = objects[objects[known].notna().all(axis=1)]
    scenes, vehicles = (sorted(objects[name].unique()) for name in ("place", "vehicle"))
    if len(scenes) < _LEAST_SCENES:
        what = f"{counted(len(scenes), 'scene')} with scored objects: too few to find rules and to test them"
        remedy = f"Give scenes.count={_LEAST_SCENES} or more; frames of one segment or log count once"
        raise InputError(what, "failure rules", remedy)
    here = objects["place"].isin(scenes[::2])
    ours = objects["vehicle"].isin(vehicles[::2])
    attacked = objects["scored_by"] == objects["detector"]
    found_on = here & ours & attacked
    groups = {
        "other scenes": ~here & ours & attacked,
        "other vehicles": ~ours & attacked,
        **{
            f"scored by {name}": ~attacked & (objects["scored_by"] == name) & ~(here & ours)
            for name in sorted(objects["scored_by"][~attacked].unique())
        },
    }
    scores, rest = objects["score"].to_numpy(np.float64), np.ones(len(objects), dtype=bool)
    tried = []
    for rule in find_rules(_quantities(objects[found_on], known), scores[found_on]):
        holds = rule.holds(_quantities(objects, known))
        trials = {name: _difference(objects, holds, rows & rest, ours) for name, rows in groups.items() if rows.any()}
        found, count = _difference(objects, holds, found_on & rest, ours), int((holds & found_on & rest).sum())
        assert found is not None, "where it was found a rule tells objects apart"
        tried.append(TriedRule(rule, count, found, trials))
        rest &= ~holds
    return tried


def _known(objects: pd.DataFrame) -> list[str]:
    """Select the quantities that differ among the objects and that at least half of the objects have."""
    return [name for name in _QUANTITIES if 2 * objects[name].count() >= len(objects) and objects[name].nunique() > 1]


def left_out(objects: pd.DataFrame) -> str | None:
    """Describe the objects excluded for missing sizes (no surface), or None. objects: see `rule_objects`."""
    lacking = int(objects[_known(objects)].isna().any(axis=1).sum())
    if not lacking:
        return None
    which = "is" if lacking == 1 else "are"
    return f"{lacking} of {counted(len(objects), 'scored object')} {which} left out: their sizes are unknown"


def rule_objects(sweep: Sweep) -> pd.DataFrame:
    """Build the table of scored baseline, random and adversarial objects with all quantities, one row per detector.

    Sizes are NaN for shapes that were not measured; objects of a pose task have the baseline's sizes. A baseline that
    tasks share is one object, and so is a vehicle that no search step has changed. The vehicle of a shape of another
    kind is the vehicle that renders it.
    """
    rows = sweep.scored
    rows = rows[rows["method"].isin(_METHODS)].drop_duplicates(["task_id", "scored_by", "method", "replicate"])
    posed = rows["mode"] == "pose"
    rows = rows.assign(shape=rows["method"].mask(posed, "baseline"), copy=rows["replicate"].mask(posed, 0))
    sizes = sweep.shapes[["task_id", "method", "replicate", *_SIZES]]
    sizes = sizes.rename(columns={"method": "shape", "replicate": "copy"}).drop_duplicates(["task_id", "shape", "copy"])
    rows = rows.merge(sizes, on=["task_id", "shape", "copy"], how="left")
    pose = ["x_m", "y_m", "z_m", "yaw_rad", "pitch_rad", "roll_rad"]
    settings = ["detector", "scored_by", "accuracy", "effects"]
    rows = rows.drop_duplicates(["dataset", "scene", "vehicle", *settings, *pose, *_SIZES, "score"])
    kinds = sweep.solutions[["task_id", "method", "replicate", "drawn_as"]]
    rows = rows.merge(kinds, on=["task_id", "method", "replicate"], how="left")
    rows = rows.assign(vehicle=rows["drawn_as"].fillna(rows["vehicle"]))
    tilt = np.degrees(np.maximum(rows["pitch_rad"].abs(), rows["roll_rad"].abs()))
    aspect = aspect_deg(rows["x_m"].to_numpy(), rows["y_m"].to_numpy(), rows["yaw_rad"].to_numpy())
    return rows.assign(tilt_deg=tilt, aspect_deg=aspect)


def _quantities(rows: pd.DataFrame, names: list[str]) -> dict[str, NDArray[np.float64]]:
    return {name: rows[name].to_numpy(np.float64) for name in names}


def _difference(objects: pd.DataFrame, holds: NDArray[np.bool_], rows: pd.Series, ours: pd.Series) -> Interval | None:
    """Compute the difference in mean score between matched and other objects of some rows; None if a side is empty.

    Scenes are random draws. If rows contain vehicles that the rule was not found on, vehicles are draws too: the
    evidence about new vehicles is limited by their number, however many scenes they appear in.

    holds, rows, ours: masks (N,) over objects; ours: vehicles that rules are found on.
    """
    inside, part = holds[rows], objects[rows]
    if inside.all() or not inside.any():
        return None
    others = part["vehicle"] if (rows & ~ours).any() else None
    return difference_interval(part["score"], inside, part["place"], others)


def rules_table(rules: list[TriedRule]) -> Table:
    """Build the table: one line per rule, its objects that no line above matches, and the difference in each group."""
    lines: list[list[str]] = []
    for tried in rules:
        cells = [_difference_text(found) for found in (tried.found, *tried.tried.values())]
        words = f"{'else ' if lines else ''}{rule_text(tried.rule)}"
        lines.append([words, str(tried.objects), *cells, "yes" if tried.confirmed else "no"])
    header = ["", "objects", "score minus others'", *(rules[0].tried if rules else ()), "holds"]
    return Table("Failure rules: what the missed objects share", header, lines)


def _difference_text(found: Interval | None) -> str:
    """Format a difference, without the interval if a side has fewer than two scenes or vehicles."""
    if found is None or math.isfinite(found.low):
        return interval_text(found, 2)
    return f"{found.mean:+.2f} (too few)"


def rule_text(rule: FailureRule) -> str:
    """Format a rule, e.g. "range over 32 m, height at most 135 cm"."""
    return ", ".join(_condition_text(condition) for condition in rule.conditions)


def _condition_text(condition: Condition) -> str:
    what, unit, factor, digits = _QUANTITIES[condition.quantity]
    low, high = (f"{factor * value:.{digits}f}{unit}" for value in (condition.low, condition.high))
    if math.isinf(condition.low):
        return f"{what} at most {high}"
    return f"{what} over {low}" if math.isinf(condition.high) else f"{what} {low} to {high}"
