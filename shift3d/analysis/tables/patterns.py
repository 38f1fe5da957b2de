"""Patterns of attacks: mean changes of mesh measures and poses over all solutions, in centimetres and degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from shift3d.analysis.results import places_of
from shift3d.analysis.statistics.intervals import Interval, mean_interval
from shift3d.analysis.tables.table import Table, interval_text, number
from shift3d.analysis.variants import with_search
from shift3d.evaluation.failure_rules import aspect_deg

# Wording, unit and digits of each mesh measure.
NAMES = {
    "length_cm": ("length", "cm", 0),
    "width_cm": ("width", "cm", 0),
    "height_cm": ("height", "cm", 0),
    "clearance_cm": ("ground clearance", "cm", 1),
    "nose_cm": ("nose height", "cm", 0),
    "tail_cm": ("tail height", "cm", 0),
    "bonnet_cm": ("bonnet", "cm", 0),
    "windshield_deg": ("windshield", "°", 0),
    "rear_window_deg": ("rear window", "°", 0),
    "front_overhang_cm": ("front overhang", "cm", 0),
    "wheelbase_cm": ("wheelbase", "cm", 0),
    "rear_overhang_cm": ("rear overhang", "cm", 0),
    "volume_m3": ("volume", "m³", 2),
    "pieces": ("pieces", "", 0),
}
_POSE = {
    "forward_cm": ("forward", "cm", 0),
    "left_cm": ("to the left", "cm", 0),
    "yaw_deg": ("turned to the left", "°", 0),
    "pitch_deg": ("nose down", "°", 1),
    "roll_deg": ("left side up", "°", 1),
    "aspect_deg": ("angle to the line of sight", "°", 0),
    "range_m": ("range", "m", 1),
}
# Smallest change that counts as less or more, by unit.
_SHOWN_RATIO = {"cm": 1.0, "°": 1.0, "m³": 0.01, "m": 0.01, "": 0.5}
_LEAST_SCENES = 6  # with fewer, a sign-flip test over scenes cannot reach p < 0.05, and bootstraps are too optimistic


@dataclass(frozen=True)
class Pattern:
    """Change of a measure over solutions. before: mean of the baselines. change: mean, scenes redrawn. size: mean
    absolute change. fell, rose: shares of the solutions. scenes: number of distinct places."""

    name: str
    unit: str
    digits: int
    before: float
    change: Interval
    size: float
    fell: float
    rose: float
    solutions: int
    scenes: int

    @property
    def clear(self) -> bool:
        """True if the interval excludes zero and there are enough scenes."""
        return self.scenes >= _LEAST_SCENES and (self.change.low > 0.0 or self.change.high < 0.0)


def pattern_groups(patterns: pd.DataFrame, scores: pd.DataFrame) -> list[tuple[str, list[Pattern]]]:
    """Group patterns by search, lambda, alpha, detector, and accuracy and effects if they differ, in table order.

    patterns, scores: tables of ``final/``. Shapes come from `patterns`, poses, which every sweep has, from `scores`. A
    solution is left out of a measure's line if either mesh lacks the measure.
    """
    own = scores[(scores["scored_by"] == scores["detector"]) & (scores["replicate"] == 0) & scores["score"].notna()]
    found: dict[str, list[Pattern]] = {}
    if "effects" in scores:  # the mesh table has no effects
        effects = scores.drop_duplicates("task_id").set_index("task_id")["effects"]
        patterns = patterns.assign(effects=[effects.get(task, ()) for task in patterns["task_id"]])
    for rows, changes in ((patterns, _shape_changes), (own[own["mode"] != "shape"], _pose_changes)):
        for label, group in with_search(rows).groupby("search_words", sort=False):
            both = [group[group["method"] == method].set_index("task_id") for method in ("baseline", "adversarial")]
            before, after = (part.loc[both[0].index.intersection(both[1].index)] for part in both)
            if len(before):
                found.setdefault(str(label), []).extend(_patterns(changes(before, after), places_of(before)))
    return list(found.items())


Changes = dict[str, tuple["pd.Series", "pd.Series"]]


def _shape_changes(before: pd.DataFrame, after: pd.DataFrame) -> Changes:
    return {name: (before[name].astype(float), (after[name] - before[name]).astype(float)) for name in NAMES}


def _pose_changes(before: pd.DataFrame, after: pd.DataFrame) -> Changes:
    dx, dy, yaw = after["x_m"] - before["x_m"], after["y_m"] - before["y_m"], before["yaw_rad"]
    turn = (after["yaw_rad"] - yaw + np.pi) % (2 * np.pi) - np.pi
    aspects = [aspect_deg(*(part[name].to_numpy() for name in ("x_m", "y_m", "yaw_rad"))) for part in (before, after)]
    zero = 0.0 * dx
    return {
        "forward_cm": (zero, 100 * (dx * np.cos(yaw) + dy * np.sin(yaw))),
        "left_cm": (zero, 100 * (dy * np.cos(yaw) - dx * np.sin(yaw))),
        "yaw_deg": (zero, np.degrees(turn)),
        **{
            f"{name}_deg": (np.degrees(before[f"{name}_rad"]), np.degrees(after[f"{name}_rad"] - before[f"{name}_rad"]))
            for name in ("pitch", "roll")
        },
        "aspect_deg": (zero + aspects[0], zero + aspects[1] - aspects[0]),
        "range_m": (before["range_m"], after["range_m"] - before["range_m"]),
    }


def _patterns(changes: Changes, places: pd.Series) -> list[Pattern]:
    found = []
    for field, (before, change) in changes.items():
        values = change.dropna()
        if values.empty:
            continue
        name, unit, digits = (NAMES | _POSE)[field]
        mean, size, where = float(before[values.index].mean()), float(values.abs().mean()), places[values.index]
        fell, rose = (float((sign * values >= _SHOWN_RATIO[unit]).mean()) for sign in (-1, 1))
        interval = mean_interval(values, list(where))
        found.append(Pattern(name, unit, digits, mean, interval, size, fell, rose, len(values), where.nunique()))
    return found


def patterns_table(title: str, patterns: list[Pattern]) -> Table:
    """Build the table by measure: baselines' mean, change with interval, size, shares that fell and rose."""
    lines = []
    for found in patterns:
        change = interval_text(found.change, found.digits + 1)
        texts = [f"{found.name}, {found.unit}".strip(", "), str(found.solutions), number(found.before, found.digits)]
        texts += [change, number(found.size, found.digits + 1), f"{found.fell:.0%}", f"{found.rose:.0%}"]
        few = f"fewer than {_LEAST_SCENES} scenes"
        lines.append([*texts, few if found.scenes < _LEAST_SCENES else "yes" if found.clear else "no"])
    header = ["", "solutions", "baseline", "change", "|change|", "less", "more", "excludes 0"]
    return Table(title, header, lines)
