"""Scores of the same vehicles in other scenes than those of the search, and under the beams of other sensors."""

from __future__ import annotations

import pandas as pd

from shift3d.analysis.results import PLACE, places_of, with_places
from shift3d.analysis.statistics.intervals import mean_interval, ratio_interval
from shift3d.analysis.tables.table import Table, interval_text, number
from shift3d.analysis.variants import differing_settings, with_search


def transfer_table(transfers: pd.DataFrame) -> Table | None:
    """Build the table of placements, AUC before and after, and their ratio, by mode, search and scoring detector.

    transfers: the table of ``final/``. Means are over the vehicles' means. Intervals redraw whole scenes, of the search
    and of the transfer. Placements on which the shape breaks a constraint count. Returns None without transfers.
    """
    placed = transfers[transfers["score"].notna()]
    if placed.empty:
        return None
    placed = with_search(placed).assign(place=places_of(placed, scene="other_scene"), searched_in=places_of(placed))
    lines = []
    for (label, scored_by), rows in placed.groupby(["search_words", "scored_by"], sort=False):
        before = rows.assign(score=rows["score_baseline"])
        counts = [str(len(rows)), str(rows["place"].nunique())]
        means = [number(_vehicle_mean(part)) for part in (before, rows)]
        ratio = interval_text(ratio_interval(rows, before, "searched_in"), 2, "")
        fell = rows["score"] < rows["score_baseline"]
        lines.append([label, scored_by, *counts, *means, ratio, f"{fell.mean():.0%}"])
    header = ["", "scored by", "placements", "scenes", "baseline", "shape", "ratio", "lower in"]
    return Table("Adversarial shapes in scenes other than those of their search", header, lines)


def _vehicle_mean(rows: pd.DataFrame) -> float:
    return float(rows.groupby("vehicle")["score"].mean().mean())


# A vehicle with a lower score is missed. Source: the score from which the public Waymo config shows boxes.
MISSED_BELOW = 0.1
_BEAMS = r"-beams_([a-z0-9_]+)"
_GROUP = ["mode", "method", "detector", "scored_by", "search", "settings"]
_PAIR = ["place", "street", "vehicle", "lambda", "alpha", "accuracy", "effects", "replicate", *PLACE]
_METHODS = ("baseline", "adversarial")


def paired_scores(scores: pd.DataFrame) -> dict[tuple[str, ...], tuple[pd.DataFrame, pd.DataFrame]]:
    """Pair scores and points of objects by sensor: (mode, method, detector, scored_by, search, settings) to two tables.

    scores: the table of ``final/``. settings: accuracy and effects in words, if they differ. A table has one line per
    object of a street, and one column per sensor's beams, in planned order. A baseline is the same object under every
    sensor; each adversarial object was searched under its own beams.
    """
    rows = scores[scores["method"].isin(_METHODS)]
    settings = differing_settings(rows, ("accuracy", "effects"))
    effects = rows["effects"].map(lambda names: "+".join(names))
    rows = with_places(rows).assign(settings=settings, effects=effects)
    rows = rows.assign(beams=rows["scene"].str.extract(_BEAMS, expand=False))
    # Searches with several lambdas or alphas share one baseline.
    rows = rows.assign(**{name: rows[name].mask(rows["method"] == "baseline", -1.0) for name in ("lambda", "alpha")})
    rows = rows[rows["beams"].notna() & rows["score"].notna()]
    if rows["beams"].nunique() < 2:
        return {}
    order = list(dict.fromkeys(rows["beams"]))
    street = rows["dataset"].str.replace(_BEAMS, "", regex=True) + rows["scene"].str.replace(_BEAMS, "", regex=True)
    rows = rows.assign(street=street, place=places_of(rows)).fillna({"lambda": -1.0})
    found = {}
    for group, members in rows.groupby(_GROUP, sort=False):
        tables = [members.pivot_table(index=_PAIR, columns="beams", values=name) for name in ("score", "object_points")]
        wide = [table[[beams for beams in order if beams in table]] for table in tables]
        if len(wide[0].columns) > 1:
            found[tuple(map(str, group))] = (wide[0], wide[1])
    return found


def sensor_table(scores: pd.DataFrame) -> Table | None:
    """Build the table by object type, scoring detector and sensor, paired with the first sensor of the plan.

    Differences are per object; intervals redraw whole streets. Returns None if a sweep has only one sensor's beams.
    """
    lines = []
    for (mode, method, detector, scored_by, search, settings), (score, points) in paired_scores(scores).items():
        label = ", ".join(word for word in (method, mode, search, detector, settings) if word)
        first = score.columns[0]
        for beams in score.columns:
            both = score[[first, beams]].dropna() if beams != first else score[[first]].dropna()
            if both.empty:
                continue
            missed, missed_first = both[beams] < MISSED_BELOW, both[first] < MISSED_BELOW
            apart = both[beams] - both[first]
            places = list(both.index.get_level_values("place"))  # the same street in rain and in fog is one draw
            difference = "-" if beams == first else interval_text(mean_interval(apart, places), 3)
            lines.append(
                [
                    label,
                    scored_by,
                    str(beams),
                    str(len(both)),
                    f"{points.loc[both.index, beams].median():.0f}",
                    number(float(both[beams].mean())),
                    difference,
                    f"{missed.mean():.0%}",
                    "-" if beams == first else f"{int((missed & missed_first).sum())} of {int(missed_first.sum())}",
                ]
            )
    header = ["", "scored by", "beams", "objects", "points", "score", "minus first sensor's", "missed",
              "of first sensor's misses"]  # fmt: skip
    title = f"The same vehicles at the same places under each sensor's beams; missed: a score below {MISSED_BELOW:g}"
    return Table(title, header, lines) if lines else None
