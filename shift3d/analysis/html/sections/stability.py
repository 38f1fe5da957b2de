"""Whether the solutions are stable and robust, where the sweep was verified."""

from __future__ import annotations

import math

from shift3d.analysis.html.document import Section, paragraph, table
from shift3d.analysis.html.figure import COLOURS, LEGEND_BELOW, axis, figure_html
from shift3d.analysis.results import METHODS, Sweep

__all__ = ["stability"]

_GROUP = ["mode", "lambda", "scored_by", "method"]
_HEADER = [
    "method",
    "mode",
    "lambda",
    "scored by",
    "verified",
    "unstable",
    "|score - reference|",
    "same again",
    "robust",
]
_SHOWN = 20


def stability(sweep: Sweep) -> Section:
    """The section; one line where nothing was verified."""
    found = sweep.verification
    if found is None or found.empty:
        text = "Not verified: shift3d verify OUT scores every solution again at reference accuracy."
        return Section("stability", "Stability", [paragraph(text, "missing")])
    lines = []
    for key, rows in found.groupby(_GROUP, sort=False, dropna=False):
        mode, lambda_, scored_by, method = key
        difference = float((rows["score"] - rows["score_reference"]).abs().max())
        again = float((rows["score"] == rows["score_again"]).mean())
        group = [METHODS.get(method, method), mode, "-" if math.isnan(lambda_) else f"{lambda_:g}", scored_by]
        counts = [str(len(rows)), str(int((~rows["stable"]).sum()))]
        lines.append([*group, *counts, f"{difference:.1e}", f"{again:.0%}", f"{rows['robust'].mean():.0%}"])
    lead = (
        "Scored again at reference accuracy (float64), with 2 cm of noise on the vehicle's beams, and a little off its "
        "pose. Unstable: score or margin more than 0.02 from the reference's. Robust: at least half of the margin to "
        "the baseline is left in every draw."
    )
    body = [paragraph(lead), table("Scored again", _HEADER, lines), _figure(sweep)]
    unstable = found[~found["stable"]]
    body += [paragraph(_unstable(row)) for row in unstable.head(_SHOWN).to_dict("records")]
    if len(unstable) > _SHOWN:
        body.append(paragraph(f"And {len(unstable) - _SHOWN} more unstable ones in final/verification.parquet."))
    return Section("stability", "Stability", body)


def _unstable(row: dict[str, object]) -> str:
    return (
        f"Unstable: {row['task_id']}, {row['vehicle']} in {row['scene']}, {row['method']}: {row['score']:.3f}, "
        f"reference {row['score_reference']:.3f}; {row['cause']}"
    )


def _figure(sweep: Sweep) -> str:
    found = sweep.verification
    assert found is not None
    traces = []
    for method, label in METHODS.items():
        rows = found[found["method"] == method]
        if len(rows):
            at = {"x": rows["score"].round(5).to_list(), "y": rows["score_reference"].round(5).to_list()}
            marker = {"size": 6, "color": COLOURS[method], "opacity": 0.7}
            traces.append({"type": "scatter", "mode": "markers", **at, "name": label, "marker": marker})
    diagonal = {"type": "line", "x0": 0, "y0": 0, "x1": 1, "y1": 1, "line": {"width": 1, "color": "#7d7d7d"}}
    layout = {
        "xaxis": axis("score, as reported", range=[0, 1]),
        "yaxis": axis("score at reference accuracy", range=[0, 1]),
        "shapes": [diagonal],
        "legend": LEGEND_BELOW,
    }
    largest = float((found["score"] - found["score_reference"]).abs().max())
    text = f"{len(found)} scores at reference accuracy against those reported; largest difference {largest:.1e}."
    return figure_html("stability", traces, layout, text, text, height_px=380)
