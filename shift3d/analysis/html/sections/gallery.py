"""Section of randomly drawn solutions, whatever their outcome."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from shift3d.analysis.cases.rendered import PageCache, oriented
from shift3d.analysis.cases.selection import Case, falls, random_positions
from shift3d.analysis.html.blocks import Block, Panels, Paragraph, Picture
from shift3d.analysis.html.scene_figures import side_by_side
from shift3d.analysis.results import Sweep
from shift3d.errors import InputError
from shift3d.store.schemas import POSE_COLUMNS
from shift3d.sweep.planning.tasks import PlannedTask

_COUNT = 50  # tiles
_RESOLUTION = 72  # mesh resolution: 7 cm
# Colours of baseline, adversarial and retrieved vehicles.
THREE_RGB = ((0.55, 0.57, 0.60), (0.86, 0.42, 0.12), (0.18, 0.56, 0.79))


def gallery(sweep: Sweep, loaded: PageCache) -> list[Block]:
    """Build the section: one tile per task, whatever its outcome. A tile that cannot be drawn shows the reason."""
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
    how = "" if all_of_them else ", drawn at random with equal probability, including failures and unnatural shapes"
    lead = (
        f"{which}{how}. Each picture shows the baseline on the left and the attack's solution on the right, seen from "
        "the sensor. The caption gives the attacked detector's scores of both."
    )
    return [Paragraph(lead), Panels(tiles, "tiles")]


def _tile(sweep: Sweep, task: PlannedTask, case: Case | None, rating: str, loaded: PageCache) -> Picture:
    spec = task.spec
    weight = "" if spec.lambda_ is None else f", lambda {spec.lambda_:g}"
    vehicle = spec.vehicle.replace("_", " ") if case is None else sweep.vehicle_words(spec.task_id)
    name = f"{vehicle}, {spec.mode.replace('_', ' and ')}{weight}"
    rows = sweep.scores[sweep.scores["task_id"] == spec.task_id]
    if case is None:
        status = str(rows["status"].iloc[0]).replace("_", " ") if len(rows) else "no result"
        return Picture(None, status, name)
    status = rows["status"][rows["method"] == "adversarial"].iloc[0]
    failed = "" if status == "ok" else status.replace("_", " ")
    caption = ", ".join(filter(None, (f"{name}: {case.before:.2f} → {case.after:.2f}", rating, failed)))
    alt = f"{name} in scene {spec.scene}, baseline and adversarial"
    return drawn(lambda: _pair(sweep, task, loaded), alt, caption)


def drawn(draw: Callable[[], bytes], alt: str, caption: str) -> Picture:
    """Draw a picture, or show the reason in its place if data cannot be loaded."""
    try:
        return Picture(draw(), alt, caption)
    except InputError as error:
        return Picture(None, f"cannot be drawn: {error.what}", caption)


def _pair(sweep: Sweep, task: PlannedTask, loaded: PageCache) -> bytes:
    """Render baseline and adversarial vehicle side by side, seen from the sensor, slightly from above."""
    meshes, towards_sensor = [], []
    for row in sweep.pair_of(task.spec.task_id):
        theta = row[list(POSE_COLUMNS)].to_numpy(dtype=np.float64)
        mesh = loaded.mesh(task, row, _RESOLUTION).copy()
        mesh.vertices = oriented(mesh.vertices, theta)
        meshes.append(mesh)
        towards_sensor.append(float(np.arctan2(-theta[1], -theta[0])))
    return side_by_side(meshes, towards_sensor, THREE_RGB[:2])
