"""Section: vehicles in scenes that are like the shapes that were found."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shift3d.analysis.cases.chosen import random_positions
from shift3d.analysis.cases.rendered import Loaded
from shift3d.analysis.figures.picture import COLOURS, pixels_png
from shift3d.analysis.html.blocks import Block, Command, Heading, Panels, Paragraph, Picture, Plot, Section
from shift3d.analysis.html.figure import LEGEND_BELOW, axis, band, line, plot
from shift3d.analysis.html.sections.curves import thresholds
from shift3d.analysis.results import Sweep
from shift3d.analysis.statistics.intervals import recall_band
from shift3d.analysis.tables.retrieval import kept, pool_table, retrieval_table
from shift3d.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_TITLE = "Natural kin"
_LEAD = (
    "Labelled vehicles of other scenes were cropped, and their shapes fitted to their points. The vehicle whose latent "
    "code is nearest to that of an adversarial shape is put in its place. By the paper's rule, a shape without a near "
    "one (nearer than its own code is long) is left out. Controls are vehicles of the same scenes that were seen from "
    "as far and by as many points, in the same place. In the log: before the attacked detector where they stand."
)
_CURVES = {
    "score_baseline": ("baseline", COLOURS["baseline"], "solid"),
    "score_solution": ("adversarial", COLOURS["adversarial"], "solid"),
    "score": ("retrieved", COLOURS["random"], "solid"),
    "control": ("controls", COLOURS["random_search"], "dash"),
}
_TILES, _SIZE_PX, _SPAN_M = 9, (170, 105), 5.6
_RGB = ((0.55, 0.57, 0.60), (0.86, 0.42, 0.12), (0.18, 0.56, 0.79))


def retrieval(sweep: Sweep, loaded: Loaded) -> Section:
    """The section; it says how kin are found where nobody has looked."""
    if sweep.retrieved.empty:
        lead = Paragraph("Nobody has looked for natural vehicles that are like these shapes.", "missing")
        return Section("retrieval", _TITLE, [lead, Command("It takes minutes:", "shift3d retrieve OUT")])
    table = retrieval_table(sweep.retrieved)
    own = kept(sweep.retrieved)
    own = own[own["scored_by"] == own["detector"]]
    blocks: list[Block] = [Paragraph(_LEAD), *([table] if table else []), pool_table(sweep.vehicle_pool)]
    if len(own):
        tiles = [_tile(sweep, row, loaded) for row in _drawn(own, sweep.plan.spec_hash)]
        heading = "Baseline, adversarial and retrieved vehicle, of solutions drawn at random"
        blocks += [Panels([_curves(own)]), Heading(heading), Panels(tiles, "tiles")]
    return Section("retrieval", _TITLE, blocks)


def _curves(rows: pd.DataFrame) -> Plot:
    traces: list[dict[str, Any]] = []
    areas = []
    at = thresholds().astype(np.float32)
    for column, (name, colour, dash) in _CURVES.items():
        scored = rows[rows[column].notna()]
        if scored.empty:
            continue
        recall, low, high = recall_band(scored[column], list(scored["place"]), thresholds())
        auc = f"{scored[column].mean():.3f}"
        traces += band(at, low, high, colour, line={"shape": "hv"}, legendgroup=name)
        style = {"shape": "hv", "color": colour, "dash": dash, "width": 2}
        traces.append(line(at, recall, name, style, legendgroup=name) | {"name": f"{name}, {auc}"})
        areas.append(f"{name} {auc}")
    layout = {
        "xaxis": axis("score threshold", range=[0, 1]),
        "yaxis": axis("recall", range=[0, 1.02]),
        "legend": LEGEND_BELOW,
        "hovermode": "x unified",
    }
    caption = f"Threshold-recall of {len(rows)} solutions with natural kin, in the same place"
    return plot("curve-retrieval", traces, layout, f"{caption}. Areas: {', '.join(areas)}", caption, 340)


def _drawn(rows: pd.DataFrame, seed: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = rows.iloc[random_positions(len(rows), _TILES, seed)].to_dict("records")
    return found


def _tile(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> Picture:
    scores = " → ".join(f"{row[name]:.2f}" for name in ("score_baseline", "score_solution", "score"))
    caption = f"{row['vehicle'].replace('_', ' ')}: {scores}"
    alt = f"{row['vehicle']} in scene {row['scene']}: baseline, adversarial, and the vehicle of {row['pool_scene']}"
    try:
        return Picture(pixels_png(_pixels(sweep, row, loaded)), alt, caption)
    except InputError as error:
        return Picture(None, f"cannot be drawn: {error.what}", caption)


def _pixels(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> NDArray[np.uint8]:
    """Three vehicles side by side from the front left, a little from above, to one scale."""
    from shift3d.naturalness.decoded import decoded_mesh
    from shift3d.vehicles.picture import shaded

    (task,) = sweep.plan.tasks.starting_with(row["task_id"])
    assets = loaded.assets(task)
    solutions = sweep.solutions[(sweep.solutions["task_id"] == row["task_id"]) & (sweep.solutions["replicate"] == 0)]
    both = [solutions[solutions["method"] == name].iloc[0] for name in ("baseline", "adversarial")]
    pool = sweep.vehicle_pool
    kin = pool[(pool["scene"] == row["pool_scene"]) & (pool["label"] == row["pool_label"])].iloc[0]
    meshes = [
        decoded_mesh(assets.drawn_vehicle(task.spec, row), assets.decoder, np.array(row["latent_code"])) for row in both
    ]
    own = assets.vehicle(task.spec)
    meshes.append(decoded_mesh(own, assets.decoder, np.array(kin["latent_code"])))
    meshes[2].vertices = meshes[2].vertices * (kin["scale_m"] / own.scale_m)
    span_m = max(_SPAN_M, *(1.08 * float(mesh.extents.max()) for mesh in meshes))
    views = [shaded(mesh, 0.7, 0.22, *_SIZE_PX, span_m, rgb) for mesh, rgb in zip(meshes, _RGB)]
    return np.concatenate(views, axis=1)
