"""Tables of a gate: scores before and after on the same objects, losses, and their statistical certainty."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from shift3d.analysis.results import places_of
from shift3d.analysis.statistics.intervals import Interval, mean_interval
from shift3d.analysis.statistics.loss import detectable_loss, flip_p_values, objects_needed, scene_sums
from shift3d.analysis.statistics.releases import (
    MEASURES,
    ReleaseRule,
    SimulatedRates,
    measured_differences,
    stopped_releases,
)
from shift3d.analysis.tables.table import Table, interval_text
from shift3d.wording import counted

_ROLES = {"hard": "hard objects", "control": "controls"}
_LOSS = 0.02
_POWERS = (0.8, 0.9)
_CHURNS = (0.0, 0.005, 0.01, 0.02, 0.05)
_NOISES = (0.05, 0.1, 0.2, 0.4)


@dataclass(frozen=True)
class MeasureChange:
    """One measure of one role's objects. change: after minus before, with its interval over scenes. p_value: one-sided,
    of a loss, corrected for the number of measures. worse: True if the measure stops the release."""

    role: str
    name: str
    before: float
    after: float
    change: Interval
    p_value: float
    worse: bool

    @property
    def title(self) -> str:
        """Readable name of the measure."""
        return f"{self.name} of {_ROLES[self.role]}"


@dataclass(frozen=True)
class Comparison:
    """Two releases on the same objects. rows: table of ``gate.parquet``, worst first: lost, then by change of score."""

    rows: pd.DataFrame
    measures: tuple[MeasureChange, ...]
    rule: ReleaseRule

    @property
    def worse(self) -> bool:
        """True if any measure stops the release."""
        return any(measure.worse for measure in self.measures)

    def counts(self, role: str) -> dict[str, int]:
        """Count the objects of a role: number, detected before, lost and gained since."""
        rows = self.rows[self.rows["role"] == role]
        before, after = rows["detected_before"], rows["detected"]
        masks = {"detected_before": before, "lost": before & ~after, "gained": ~before & after}
        return {"number": len(rows), **{name: int(mask.sum()) for name, mask in masks.items()}}

    @property
    def detectable(self) -> float | None:
        """Smallest loss of hard-object recall shown in 90 % of releases with the observed churn, or None."""
        hard = self.counts("hard")
        churn, level = hard["gained"] / hard["number"], self.rule.level / len(self.measures)
        return detectable_loss(hard["number"], churn, _POWERS[1], level)

    def sentence(self, against: str) -> str:
        """Format the verdict. against: name of the release before."""
        hard = self.counts("hard")
        counts = f"{hard['lost']} hard objects lost, {hard['gained']} newly detected"
        if self.worse:
            worst = min((m for m in self.measures if m.worse), key=lambda measure: measure.p_value)
            return (
                f"Worse than {against}: {worst.title} {worst.before:.3f} → {worst.after:.3f} "
                f"(p = {worst.p_value:.4f}); {counts}."
            )
        number, detected, least = hard["number"], hard["detected_before"], self.detectable
        if least is None:
            shown = "the gate misses a loss of any size in more than one release of ten"
        elif least * number > detected:
            shown = f"of which {detected} were detected before, the gate can show no loss of recall"
        else:
            shown = f"the gate would find a loss of {100 * least:.1f} points of recall in 90 % of releases"
            shown += " if objects were independent; objects of one scene are not"
        tolerated = any(m.p_value <= self.rule.level and m.change.mean < 0 for m in self.measures)
        loss = f"loss of {self.rule.tolerance:g} or more" if tolerated else "loss"
        return f"No {loss} found against {against}: {counts}. With {counted(number, 'hard object')}, {shown}."


def compare(
    objects: pd.DataFrame, before: Mapping[str, float], after: Mapping[str, float], rule: ReleaseRule
) -> Comparison:
    """Compare scores by object_id. objects: table of the suite."""
    rows = objects[["object_id", "role", "task_id", "method", "vehicle", "scene", "dataset", "mode"]].copy()
    rows["range_m"] = np.hypot(objects["x_m"], objects["y_m"])
    rows["object_points"] = objects["object_points"]
    rows["score_before"], rows["score"] = (rows["object_id"].map(dict(scores)) for scores in (before, after))
    rows["change"] = rows["score"] - rows["score_before"]
    rows["detected_before"], rows["detected"] = (
        rows[name] > rule.score_threshold for name in ("score_before", "score")
    )
    places = list(places_of(rows))
    groups = {role: own.to_numpy() for role in _ROLES if (own := rows["role"] == role).any()}
    scores = rows["score_before"].to_numpy(), rows["score"].to_numpy()
    differences = measured_differences(*scores, list(groups.values()), rule.score_threshold)
    p_values = flip_p_values(scene_sums(differences, places))
    measures = []
    for column, ((role, own), name) in enumerate(itertools.product(groups.items(), MEASURES)):
        values = [part > rule.score_threshold if name == MEASURES[0] else part for part in scores]
        change = mean_interval(differences[own, column], [place for place, taken in zip(places, own) if taken])
        old, new = (float(part[own].mean()) for part in values)
        stops = bool(rule.stops(np.array(change.mean), p_values[column]))
        measures.append(MeasureChange(role, name, old, new, change, float(p_values[column]), stops))
    rows["lost"] = rows["detected_before"] & ~rows["detected"]
    ordered = rows.sort_values(["lost", "change", "object_id"], ascending=[False, True, True], kind="stable")
    return Comparison(ordered.drop(columns="lost").reset_index(drop=True), tuple(measures), rule)


def measures_table(found: Comparison) -> Table:
    """Build the table of the tested measures."""
    lines = [
        [
            measure.title,
            f"{measure.before:.3f}",
            f"{measure.after:.3f}",
            interval_text(measure.change, 3),
            f"{measure.p_value:.4f}",
            "worse" if measure.worse else "",
        ]
        for measure in found.measures
    ]
    header = ["measure", "before", "after", "change (95 % interval)", "p of a loss", ""]
    title = (
        f"Scores above {found.rule.score_threshold:g} are detections; p-values are corrected for the number of measures"
    )
    return Table(title, header, lines, ["worst" if line[-1] else "" for line in lines])


def worst_table(found: Comparison, most: int = 40) -> Table | None:
    """Build the table of the objects with a lower score, worst first; None if there is none."""
    rows = found.rows[found.rows["change"] < 0]
    if rows.empty:
        return None
    lines = [
        [
            str(rank),
            row["role"],
            f"{row['vehicle']}, {row['mode']}",
            row["scene"],
            f"{row['range_m']:.1f}",
            str(row["object_points"]),
            f"{row['score_before']:.3f}",
            f"{row['score']:.3f}",
            "lost" if row["detected_before"] and not row["detected"] else "",
            str(row["object_id"])[:12],
        ]
        for rank, row in enumerate(rows.head(most).to_dict("records"), start=1)
    ]
    more = f"; the {most} worst are shown, gate.parquet has all" if len(rows) > most else ""
    header = ["", "role", "vehicle", "scene", "range, m", "points", "before", "after", "", "object"]
    return Table(f"{counted(len(rows), 'object')} with a lower score{more}", header, lines)


def power_table(measures: int, level: float) -> Table:
    """Build the table: number of hard objects that show a loss of recall, by churn without a loss."""
    lines = []
    for churn in _CHURNS:
        needed = [objects_needed(_LOSS, churn, power, level / measures) for power in _POWERS]
        lines.append([f"{100 * churn:g} %", *("more than a million" if n is None else f"{n:,}" for n in needed)])
    header = ["lost and gained by chance, each", *(f"{power:.0%} power" for power in _POWERS)]
    return Table(f"Hard objects needed to show a loss of {100 * _LOSS:g} points of recall, at most", header, lines)


def simulated_rates(found: Comparison) -> list[SimulatedRates]:
    """Compute the rate at which this gate stops releases simulated around the scores before, by noise level."""
    rows = found.rows.sort_values("object_id", kind="stable")
    hard, places = (rows["role"] == "hard").to_numpy(), list(places_of(rows))
    scores = rows["score_before"].to_numpy()
    return [stopped_releases(scores, hard, places, noise, _LOSS, found.rule) for noise in _NOISES]


def simulation_table(rates: Sequence[SimulatedRates]) -> Table:
    """Build the table of `simulated_rates`."""
    lines = [
        [
            f"{rate.churn:g}",
            f"{rate.lost:.1%}",
            f"{rate.false_alarms:.1%}",
            "too few detected" if rate.found is None else f"{rate.found:.1%}",
        ]
        for rate in rates
    ]
    header = ["noise of the logits", "hard objects lost by chance", "stopped without a loss", "stopped with a loss"]
    title = f"200 simulated releases of these objects, without and with a loss of {100 * _LOSS:g} points of recall"
    return Table(title, header, lines)
