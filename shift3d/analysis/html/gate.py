"""Page of a gate: verdict, pictures of the worst objects, every score before and after, and statistical power."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shift3d.analysis.cases.suite_views import FrozenView
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Article, Block, Panels, Paragraph, Plot, Section, Terms, missing
from shift3d.analysis.html.document import document
from shift3d.analysis.html.figure import LEGEND_BELOW, axis, marks, plot, plotly_library, short
from shift3d.analysis.html.scene_figures import dots, square_plot, top_view_traces
from shift3d.analysis.statistics.releases import SimulatedRates
from shift3d.analysis.tables.gate import Comparison, measures_table, power_table, simulation_table, worst_table

_MEANING = {
    "hard object": "a solution of the sweep, frozen with its scene when the suite was made",
    "control": "the unchanged vehicle of the same task and scene",
    "score": "score of the best box within the detection radius of the object's centre; 0 without such a box",
    "recall": "share of the objects with a score above score_threshold",
    "lost": "detected by the release before, but not by the new weights",
    "test": "each draw swaps before and after in random scenes, for all measures together; p is the share of 10,000 "
    "draws (of all patterns for 13 scenes or fewer) in which the largest standardised loss of any measure is at least "
    "that of this measure",
}


def gate_html(
    found: Comparison,
    sentence: str,
    caution: str,
    views: Mapping[str, FrozenView],
    rates: Sequence[SimulatedRates],
    facts: Mapping[str, str],
) -> str:
    """Render the whole page; the same result gives the same text.

    sentence: the verdict. caution: caveat about the verdict, or empty. views: of the worst objects, by object_id.
    rates: of simulated releases. facts: about suite and weights, by name.
    """
    verdict: list[Block] = [Paragraph(sentence, "worst" if found.worse else "")]
    verdict += [Paragraph(caution)] if caution else []
    verdict += [measures_table(found)]
    sure: list[Block] = [
        Paragraph(
            "Any two trainings move some objects with a score near the threshold across it. The more such objects a "
            "suite has, the more objects it needs to show a loss. The first table is for independent objects and the "
            "test of recall alone; the second simulates the whole test on these objects."
        ),
        power_table(len(found.measures), found.rule.level),
        simulation_table(rates),
    ]
    worst = [*_articles(found, views), *filter(None, [worst_table(found)])]
    sections = [
        Section("verdict", "Verdict", verdict),
        Section("worst", "Lower scores, worst first", worst),
        Section("scores", "Every object, before and after", [_scatter(found)]),
        Section("power", "Losses that this suite can show", sure),
        Section("compared", "What was compared", [Terms(facts), Terms(_MEANING)]),
    ]
    return document("shift3d: gate", sections, "Scores of new weights on a suite of hard objects.", plotly_library())


def _articles(found: Comparison, views: Mapping[str, FrozenView]) -> list[Block]:
    rows = {row["object_id"]: row for row in found.rows.to_dict("records")}
    parts: list[Block] = []
    for number, (key, view) in enumerate(views.items(), start=1):
        row = rows[key]
        title = f"{number}. {row['vehicle']}, {row['role']}: score {row['score_before']:.2f} → {row['score']:.2f}"
        both = Panels([_above(f"above-{number}", view), _side(f"side-{number}", view)])
        text = f"Scene {row['scene']}, {row['range_m']:.1f} m away, {row['object_points']} points, object {key[:12]}."
        parts.append(Article(f"object-{number}", title, [Paragraph(text), both]))
    return parts or [missing("No score fell.")]


def _above(key: str, view: FrozenView) -> Plot:
    traces, best = top_view_traces(view, COLOURS["adversarial"], "points on the object")
    caption = f"From above, scene frame: {best}"
    return square_plot(key, traces, caption, caption, view.box[:2], 10.0)


def _side(key: str, view: FrozenView) -> Plot:
    half, top, bottom = view.box[3] / 2.0, view.box[2] + view.box[5] / 2.0, view.box[2] - view.box[5] / 2.0
    edge = {"x": [-half, half, half, -half, -half], "y": short([bottom, bottom, top, top, bottom])}
    box = {"type": "scatter", "mode": "lines", **edge, "name": "ground truth"}
    own = dots(view.object_side, COLOURS["adversarial"], 3, "points on the object")
    traces = [dots(view.scene_side, "#8a8a8a", 2, "scene"), own, {**box, "line": {"color": "#2f9e44", "dash": "dash"}}]
    caption, middle = "From the side, front to the right", np.array([0.0, 1.0])
    return square_plot(key, traces, caption, caption, middle, 5.0, names=("along, m", "height, m"))


def _scatter(found: Comparison) -> Plot:
    traces: list[dict[str, Any]] = []
    for role, name, colour in (("control", "controls", COLOURS["baseline"]), ("hard", "hard objects", "#d55e00")):
        rows = found.rows[found.rows["role"] == role]
        if rows.empty:
            continue
        texts = [f"{row.vehicle}, {row.scene}, {row.object_id[:12]}" for row in rows.itertuples()]
        marker = {"size": 6, "color": colour, "opacity": 0.7}
        hover = {"text": texts, "hovertemplate": "%{text}<br>%{x:.3f} → %{y:.3f}<extra></extra>"}
        traces.append(marks(short(rows["score_before"]), short(rows["score"]), marker, name=name, **hover))
    same = {"type": "scatter", "mode": "lines", "x": [0, 1], "y": [0, 1], "name": "no change", "hoverinfo": "skip"}
    traces.append({**same, "line": {"color": "#8a8a8a", "width": 1}})
    limit = {"type": "line", "line": {"color": "#8a8a8a", "width": 1, "dash": "dot"}}
    t = found.rule.score_threshold
    shapes = [{**limit, "x0": t, "x1": t, "y0": 0, "y1": 1}, {**limit, "y0": t, "y1": t, "x0": 0, "x1": 1}]
    layout = {
        "xaxis": axis("score before", range=[-0.02, 1.02], constrain="domain"),
        "yaxis": axis("score after", range=[-0.02, 1.02], scaleanchor="x", constrain="domain"),
        "shapes": shapes,
        "legend": LEGEND_BELOW,
    }
    caption = "Below the line: lower score. Dotted: the score threshold. Lower right quadrant: lost"
    return plot("scores", traces, layout, "Scores before and after", caption, 520)
