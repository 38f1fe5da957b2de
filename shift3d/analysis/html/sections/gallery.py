"""Solutions drawn at random, whatever became of them, and vehicles in scenes that are like what was found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.cases.chosen import Case, falls, random_positions
from shift3d.analysis.cases.rendered import Loaded, oriented
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Command, Heading, Panels, Paragraph, Picture, Plot, Section
from shift3d.analysis.html.scene_figures import side_by_side
from shift3d.analysis.html.sections.curves import RecallCurve, recall_plot
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.retrieval import kept, pool_table, retrieval_table
from shift3d.errors import InputError
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.wording import counted

_COUNT, _KIN_COUNT = 50, 9  # tiles
_RESOLUTION = 72  # of the meshes: 7 cm
_RGB = ((0.55, 0.57, 0.60), (0.86, 0.42, 0.12), (0.18, 0.56, 0.79))
"""Of baseline, adversarial and retrieved vehicles."""


def gallery(sweep: Sweep, loaded: Loaded) -> Section:
    """The section: a tile a task, whatever became of it. What cannot be drawn is named, not raised."""
    positions = random_positions(len(sweep.plan.tasks), _COUNT, sweep.plan.spec_hash)
    scored = {case.task_id: case for case in falls(sweep.scores)}
    tiles = []
    for position in positions:
        task = sweep.plan.tasks[position]
        case = scored.get(task.spec.task_id)
        natural = sweep.verdicts.get(task.spec.task_id)
        rating = "" if natural is None else "natural" if natural else "unnatural"
        tiles.append(_tile(sweep, task, case, rating, loaded))
    all_of_them = len(positions) == len(sweep.plan.tasks)
    which = f"All {len(positions)} tasks" if all_of_them else f"{len(positions)} of the {len(sweep.plan.tasks)} tasks"
    how = "" if all_of_them else ", drawn at random, each as likely as any other: failures and unnatural shapes too"
    lead = (
        f"{which}{how}. To the left the baseline, to the right what the attack found, as the sensor sees them; below, "
        "the scores of both before the attacked detector."
    )
    return Section("gallery", "Gallery", [Paragraph(lead), Panels(tiles, "tiles")])


def _tile(sweep: Sweep, task: PlannedTask, case: Case | None, rating: str, loaded: Loaded) -> Picture:
    spec = task.spec
    weight = "" if spec.lambda_ is None else f", lambda {spec.lambda_:g}"
    name = f"{spec.vehicle.replace('_', ' ')}, {spec.mode.replace('_', ' and ')}{weight}"
    if case is None:
        rows = sweep.scores[sweep.scores["task_id"] == spec.task_id]
        status = str(rows["status"].iloc[0]).replace("_", " ") if len(rows) else "no result"
        return Picture(None, status, name)
    own = sweep.scores[(sweep.scores["task_id"] == spec.task_id) & (sweep.scores["method"] == "adversarial")]
    failed = "" if own["status"].iloc[0] == "ok" else str(own["status"].iloc[0]).replace("_", " ")
    caption = ", ".join(filter(None, (f"{name}: {case.before:.2f} → {case.after:.2f}", rating, failed)))
    alt = f"{name} in scene {spec.scene}, baseline and adversarial"
    return _drawn(lambda: _pair(sweep, task, loaded), alt, caption)


def _drawn(draw: Callable[[], bytes], alt: str, caption: str) -> Picture:
    """A picture; in its place why there is none, where something cannot be loaded."""
    try:
        return Picture(draw(), alt, caption)
    except InputError as error:
        return Picture(None, f"cannot be drawn: {error.what}", caption)


def _pair(sweep: Sweep, task: PlannedTask, loaded: Loaded) -> bytes:
    """Baseline and adversarial vehicle side by side, each from where the sensor stands, a little from above."""
    meshes, towards_sensor = [], []
    for row in sweep.pair_of(task.spec.task_id):
        theta = row[list(POSE_COLUMNS)].to_numpy(dtype=np.float64)
        mesh = loaded.mesh(task, row, _RESOLUTION).copy()
        mesh.vertices = oriented(mesh.vertices, theta)
        meshes.append(mesh)
        towards_sensor.append(float(np.arctan2(-theta[1], -theta[0])))
    return side_by_side(meshes, towards_sensor, _RGB[:2])


_KIN_TITLE = "Natural kin"
_KIN_LEAD = (
    "Labelled vehicles of other scenes were cropped, and their shapes fitted to their points. The vehicle whose latent "
    "code is nearest to that of an adversarial shape is put in its place. By the paper's rule, a shape without a near "
    "one (nearer than its own code is long) is left out. Controls are vehicles of the same scenes that were seen from "
    "as far and by as many points, in the same place. In the log: before the attacked detector where they stand."
)
_KIN_CURVES = {
    "score_baseline": ("baseline", COLOURS["baseline"], "solid"),
    "score_solution": ("adversarial", COLOURS["adversarial"], "solid"),
    "score": ("retrieved", COLOURS["random"], "solid"),
    "control": ("controls", COLOURS["random_search"], "dash"),
}


def retrieval(sweep: Sweep, loaded: Loaded) -> Section:
    """The section; it says how kin are found where nobody has looked."""
    if sweep.retrieved.empty:
        lead = Paragraph("Nobody has looked for natural vehicles that are like these shapes.", "missing")
        return Section(
            "retrieval", _KIN_TITLE, [lead, Command("A vehicle of the set takes some seconds:", "shift3d retrieve OUT")]
        )
    table = retrieval_table(sweep.retrieved)
    own = kept(sweep.retrieved)
    own = own[own["scored_by"] == own["detector"]]
    blocks: list[Block] = [Paragraph(_KIN_LEAD), *([table] if table else []), pool_table(sweep.vehicle_pool)]
    if len(own):
        drawn = own.iloc[random_positions(len(own), _KIN_COUNT, sweep.plan.spec_hash)].to_dict("records")
        tiles = [_kin_tile(sweep, row, loaded) for row in drawn]
        heading = "Baseline, adversarial and retrieved vehicle, of solutions drawn at random"
        blocks += [Panels([_curves(own)]), Heading(heading), Panels(tiles, "tiles")]
    return Section("retrieval", _KIN_TITLE, blocks)


def _curves(rows: pd.DataFrame) -> Plot:
    found = []
    for column, (name, colour, dash) in _KIN_CURVES.items():
        scored = rows[rows[column].notna()]
        found.append(RecallCurve(name, scored[column], scored["place"], colour, dash))
    caption = f"Threshold-recall of {counted(len(rows), 'solution')} with natural kin, in the same place"
    return recall_plot("curve-retrieval", found, caption, caption)


def _kin_tile(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> Picture:
    scores = " → ".join(f"{row[name]:.2f}" for name in ("score_baseline", "score_solution", "score"))
    caption = f"{row['vehicle'].replace('_', ' ')}: {scores}"
    alt = f"{row['vehicle']} in scene {row['scene']}: baseline, adversarial, and the vehicle of {row['pool_scene']}"
    return _drawn(lambda: _three(sweep, row, loaded), alt, caption)


def _three(sweep: Sweep, row: dict[str, Any], loaded: Loaded) -> bytes:
    """Three vehicles side by side from the front left, a little from above, to one scale."""
    from shift3d.naturalness.decoded import decoded_mesh

    (task,) = sweep.plan.tasks.starting_with(row["task_id"])
    assets, pool = loaded.assets(task), sweep.vehicle_pool
    kin = pool[(pool["scene"] == row["pool_scene"]) & (pool["label"] == row["pool_label"])].iloc[0]
    meshes = [
        decoded_mesh(assets.drawn_vehicle(task.spec, own), assets.decoder, np.array(own["latent_code"]))
        for own in sweep.pair_of(row["task_id"])
    ]
    own = assets.vehicle(task.spec)
    meshes.append(decoded_mesh(own, assets.decoder, np.array(kin["latent_code"])))
    meshes[2].vertices = meshes[2].vertices * (kin["scale_m"] / own.scale_m)
    return side_by_side(meshes, [0.7] * 3, _RGB)
