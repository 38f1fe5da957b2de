"""The score along the steps of a search: of one case, and on average."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.analysis.html.document import Section, aside, paragraph
from shift3d.analysis.html.figure import COLOURS, LEGEND_BELOW, axis, figure_html, filled
from shift3d.analysis.results import Sweep, Variant
from shift3d.analysis.statistics.areas import resampled_band

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["case_path", "mean_path", "paths", "searched"]

_TITLE = "The score along the steps"
_OPEN = 2  # variants in sight; the others fold
_DASHES = ("dot", "dash", "dashdot", "longdash", "longdashdot")


def paths(sweep: Sweep, found: list[Variant]) -> Section:
    """The section: the mean path of each search, with a band. Searches are those of the attacked detector."""
    own = [variant for variant in found if variant.detector == variant.scored_by]
    drawn = [(variant, rows) for variant in own if len(rows := searched(sweep, variant))]
    if not drawn:
        return Section("paths", _TITLE, [paragraph("This sweep kept no scores along the steps.", "missing")])
    body = [
        paragraph(
            "What the search saw at every step, step 0 being the unchanged vehicle: the score of the best box within "
            "5 m before boxes suppress each other, at the search's own precision; so it may differ a little from the "
            "scores in the tables. Mean over tasks; band: 95 %, pointwise, scenes redrawn. A search reports its best "
            "valid step, not its last."
        )
    ]
    for number, (variant, rows) in enumerate(drawn):
        figure = _figure(variant, rows)
        body.append(figure if number < _OPEN else aside(f"Steps: {variant.label}", [figure]))
    return Section("paths", _TITLE, body)


def searched(sweep: Sweep, variant: Variant) -> pd.DataFrame:
    """Rows of ``trajectories.parquet`` of a variant's tasks, with `place`: their scene."""
    rows = sweep.trajectories[sweep.trajectories["task_id"].isin(set(variant.rows["task_id"]))]
    return rows.assign(place=rows["dataset"] + "/" + rows["scene"])


def mean_path(rows: pd.DataFrame) -> tuple[Any, Any, Any, Any]:
    """Step (S,), mean score, and its band's low and high, None for a single scene.

    rows: columns task_id, place, step, proposal_score. A search that ended early stays at its last score.
    """
    table = rows.pivot_table(index=["place", "task_id"], columns="step", values="proposal_score").sort_index(axis=1)
    filled_up = table.ffill(axis=1)
    places = list(filled_up.index.get_level_values("place"))
    return table.columns.to_numpy(), *resampled_band(filled_up.to_numpy(), places, "path band")


def _figure(variant: Variant, rows: pd.DataFrame) -> str:
    steps, mean, low, high = mean_path(rows)
    colour = COLOURS["adversarial"]
    traces: list[dict[str, Any]] = []
    if low is not None and high is not None:
        edge = {"type": "scatter", "mode": "lines", "x": steps, "line": {"width": 0, "color": colour}}
        hidden = {**edge, "hoverinfo": "skip", "showlegend": False}
        traces += [{**hidden, "y": _short(low)}, {**hidden, "y": _short(high), "fill": "tonexty",
                                                  "fillcolor": filled(colour)}]  # fmt: skip
    for number, vehicle in enumerate(variant.vehicles if len(variant.vehicles) > 1 else []):
        at, own, *_ = mean_path(rows[rows["vehicle"] == vehicle])
        line = {"color": "#8a8a8a", "width": 1.5, "dash": _DASHES[number % len(_DASHES)]}
        traces.append(_line(at, own, vehicle.replace("_", " "), line))
    traces.append(_line(steps, mean, "mean", {"color": colour, "width": 3}))
    tasks, scenes = rows["task_id"].nunique(), rows["place"].nunique()
    text = f"{variant.label[0].upper()}{variant.label[1:]}: mean score {mean[0]:.3f} → {mean[-1]:.3f} in {steps[-1]} "
    text += f"steps; {tasks} task{'s' if tasks != 1 else ''}, {scenes} scene{'s' if scenes != 1 else ''}"
    return figure_html(f"path-{variant.key}", traces, _layout(int(steps[-1])), f"Score by step. {text}", text, 360)


def case_path(key: str, rows: pd.DataFrame) -> str:
    """The figure of one task's steps, the kept one marked; a sentence where the sweep kept none."""
    rows = rows[rows["proposal_score"].notna()]
    if rows.empty:
        return paragraph("This sweep kept no scores along the steps.", "missing")
    steps, scores = rows["step"].to_numpy(), rows["proposal_score"].to_numpy()
    kept, broken = rows[rows["kept"]], rows[~rows["valid"]]
    traces = [_line(steps, scores, "score", {"color": COLOURS["adversarial"], "width": 2})]
    for part, name, symbol in ((broken, "breaks a constraint", "x"), (kept, "kept", "circle")):
        marker = {"size": 10, "symbol": symbol, "color": "#9b5de5" if name == "kept" else "#8a8a8a"}
        at = {"x": part["step"].to_numpy(), "y": _short(part["proposal_score"].to_numpy())}
        traces += [{"type": "scatter", "mode": "markers", **at, "marker": marker, "name": name}] if len(part) else []
    best = int(kept["step"].iloc[0]) if len(kept) else 0
    caption = f"Score along the steps, as the search saw it: {scores[0]:.2f} at the start, step {best} kept"
    return figure_html(f"{key}-path", traces, _layout(int(steps[-1])), caption, caption, 260)


def _line(steps: Any, scores: Any, name: str, line: dict[str, Any]) -> dict[str, Any]:
    hover = {"hovertemplate": f"{name} %{{y:.3f}}<extra></extra>"}
    return {"type": "scatter", "mode": "lines", "x": steps, "y": _short(scores), "line": line, "name": name, **hover}


def _short(values: Any) -> Any:
    return np.round(values, 4).astype(np.float32)


def _layout(last: int) -> dict[str, Any]:
    sides = {"xaxis": axis("step", range=[0, max(last, 1)]), "yaxis": axis("score", range=[0, 1.02])}
    return {**sides, "legend": LEGEND_BELOW, "hovermode": "x unified"}
