"""Section of real vehicles that resemble the adversarial shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.cases.rendered import PageCache
from shift3d.analysis.cases.selection import random_positions
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Command, Heading, Panels, Paragraph, Picture, Plot, missing
from shift3d.analysis.html.scene_figures import side_by_side
from shift3d.analysis.html.sections.curves import RecallCurve, recall_plot
from shift3d.analysis.html.sections.gallery import THREE_RGB, drawn
from shift3d.analysis.results import Sweep, places_of
from shift3d.analysis.tables.retrieval import controls_of, kept, pool_table, pool_vehicle_of, retrieval_table
from shift3d.naturalness.decoded import decoded_mesh
from shift3d.wording import counted

_COUNT = 9  # tiles
_LEAD = (
    "shift3d crops labelled vehicles of other scenes and fits a latent code to the points of each. The vehicle with "
    "the code nearest to that of an adversarial shape takes the place of the shape. By the paper's rule, a shape is "
    "left out if the distance to the nearest code is not smaller than the norm of its own code. Controls are "
    "other vehicles of these scenes at the same place, with a range and a number of points similar to those of the "
    "retrieved vehicle. In the log: the vehicles at their original places, scored by the pool's detector."
)
_CURVES = {
    "score_baseline": ("baseline", COLOURS["baseline"]),
    "score_solution": ("adversarial", COLOURS["adversarial"]),
    "score": ("retrieved", COLOURS["random"]),
}


def retrieval(sweep: Sweep, loaded: PageCache) -> list[Block]:
    """Build the section; if no vehicles were retrieved, show the command to run."""
    if sweep.retrieved.empty and not sweep.solutions["mode"].ne("pose").any():
        return [missing("No task found a shape.")]
    if sweep.retrieved.empty:
        nothing = missing("No search for natural vehicles similar to these shapes has run.")
        return [nothing, Command("Run the search; each vehicle of the set takes some seconds:", "shift3d retrieve OUT")]
    table = retrieval_table(sweep.retrieved)
    own = kept(sweep.retrieved)
    own = own[own["scored_by"] == own["detector"]]
    blocks: list[Block] = [Paragraph(_LEAD), *([table] if table else []), pool_table(sweep.vehicle_pool)]
    if len(own):
        shown = own.iloc[random_positions(len(own), _COUNT, sweep.plan.spec_hash)].to_dict("records")
        tiles = [_kin_tile(sweep, row, loaded) for row in shown]
        heading = "Baseline, adversarial and retrieved vehicle of randomly drawn solutions"
        controls = controls_of(sweep.retrieved)
        controls = controls[controls["scored_by"] == controls["detector"]]
        blocks += [Panels([kin_curves(own, controls)]), Heading(heading), Panels(tiles, "tiles")]
    return blocks


def kin_curves(rows: pd.DataFrame, controls: pd.DataFrame) -> Plot:
    """Plot recall of baselines, solutions and their kin (all in `rows`, see `kept`), and of every control."""
    found = [RecallCurve(name, rows[column], rows["place"], colour) for column, (name, colour) in _CURVES.items()]
    found.append(RecallCurve("controls", controls["score"], places_of(controls), COLOURS["random_budget"], "dash"))
    label = f"Threshold-recall of {counted(len(rows), 'solution')} and their natural kin at the same place"
    caption = f"{label}; each control counts once, in the table each solution; bands resample the solutions' scenes"
    return recall_plot("curve-retrieval", found, label, caption)


def _kin_tile(sweep: Sweep, row: dict[str, Any], loaded: PageCache) -> Picture:
    scores = " → ".join(f"{row[name]:.2f}" for name in ("score_baseline", "score_solution", "score"))
    caption = f"{row['vehicle'].replace('_', ' ')}: {scores}"
    alt = f"{row['vehicle']} in scene {row['scene']}: baseline, adversarial, and the vehicle of {row['pool_scene']}"
    return drawn(lambda: _three(sweep, row, loaded), alt, caption)


def _three(sweep: Sweep, row: dict[str, Any], loaded: PageCache) -> bytes:
    """Render three vehicles side by side from the front left, slightly from above, at one scale."""
    (task,) = sweep.plan.tasks.starting_with(row["task_id"])
    assets, pool = loaded.assets(task), sweep.vehicle_pool
    kin = pool_vehicle_of(pool, row)
    meshes = [
        decoded_mesh(assets.rendered_vehicle(task.spec, own), assets.decoder, np.array(own["latent_code"]))
        for own in sweep.pair_of(row["task_id"])
    ]
    own = assets.vehicle(task.spec)
    meshes.append(decoded_mesh(own, assets.decoder, np.array(kin["latent_code"])))
    meshes[2].vertices = meshes[2].vertices * (kin["scale_m"] / own.scale_m)
    return side_by_side(meshes, [0.7] * 3, THREE_RGB)
