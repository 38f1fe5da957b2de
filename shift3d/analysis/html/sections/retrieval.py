"""Section: vehicles in scenes that are like the shapes that were found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.cases.chosen import random_positions
from shift3d.analysis.cases.rendered import Loaded
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Command, Heading, Panels, Paragraph, Picture, Plot, Section
from shift3d.analysis.html.scene_figures import side_by_side
from shift3d.analysis.html.sections.curves import RecallCurve, recall_plot
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.retrieval import kept, pool_table, retrieval_table
from shift3d.errors import InputError

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
_TILES = 9
_RGB = ((0.55, 0.57, 0.60), (0.86, 0.42, 0.12), (0.18, 0.56, 0.79))


def retrieval(sweep: Sweep, loaded: Loaded) -> Section:
    """The section; it says how kin are found where nobody has looked."""
    if sweep.retrieved.empty:
        lead = Paragraph("Nobody has looked for natural vehicles that are like these shapes.", "missing")
        return Section(
            "retrieval", _TITLE, [lead, Command("A vehicle of the set takes some seconds:", "shift3d retrieve OUT")]
        )
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
    found = []
    for column, (name, colour, dash) in _CURVES.items():
        scored = rows[rows[column].notna()]
        found.append(RecallCurve(name, scored[column], scored["place"], colour, dash))
    caption = f"Threshold-recall of {len(rows)} solutions with natural kin, in the same place"
    return recall_plot("curve-retrieval", found, caption, caption)


def _drawn(rows: pd.DataFrame, seed: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = rows.iloc[random_positions(len(rows), _TILES, seed)].to_dict("records")
    return found


def _tile(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> Picture:
    scores = " → ".join(f"{row[name]:.2f}" for name in ("score_baseline", "score_solution", "score"))
    caption = f"{row['vehicle'].replace('_', ' ')}: {scores}"
    alt = f"{row['vehicle']} in scene {row['scene']}: baseline, adversarial, and the vehicle of {row['pool_scene']}"
    try:
        return Picture(_picture(sweep, row, loaded), alt, caption)
    except InputError as error:
        return Picture(None, f"cannot be drawn: {error.what}", caption)


def _picture(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> bytes:
    """Three vehicles side by side from the front left, a little from above, to one scale."""
    from shift3d.naturalness.decoded import decoded_mesh

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
    return side_by_side(meshes, [0.7] * 3, _RGB)
