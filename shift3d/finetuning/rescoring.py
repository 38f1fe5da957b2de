"""Scores of a sweep's objects: by the attacked weights, and by fine-tuned weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa

from shift3d.detectors.base import Detector
from shift3d.detectors.loading import detector_of
from shift3d.finetuning.objects import SweepObject, refuse_other_weights, scored_objects
from shift3d.progress_bar import progress_bar
from shift3d.settings.catalogue.detector_files import file_hash
from shift3d.store.resolve import LocationLike
from shift3d.store.schemas import schema_of_columns
from shift3d.task.assets import score_precision
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.scoring import score_points
from shift3d.training.provenance import refuse_tuned_scenes

METHODS = ("baseline", "adversarial")  # methods whose objects are scored
RESCORED = schema_of_columns("rescored", 1, "task_id vehicle place settings method score:float64")
"""One row per object. place: data set and street or frame. settings: other settings that distinguish objects."""


def attacked_scores(folder: LocationLike, detector: str, weights: Path | None = None) -> pa.Table:
    """Return the attacked detector's scores of a sweep's objects, as `RESCORED`.

    Raises: InputError: as `scored_objects`; the sweep attacked other weights than these.
    """
    found = scored_objects(folder, detector, METHODS)
    if weights is not None:
        refuse_other_weights(
            found, file_hash(weights), f"{weights} holds", "Remove the folder and run the command again"
        )
    return _table([(row, row.score) for row in found.objects])


def rescore_objects(folder: LocationLike, detector: str, weights: Path) -> pa.Table:
    """Render a sweep's objects again and score them with other weights of the attacked detector, as `RESCORED`.

    On one machine the sweep's own weights reproduce its scores bit for bit.
    Raises: InputError: as `scored_objects`; weights that cannot be loaded, or were fine-tuned on a scene of the sweep.
    """
    found = scored_objects(folder, detector, METHODS)
    refuse_tuned_scenes(weights, found.scenes)
    scores = []
    judges: dict[str, Detector] = {}
    for row in progress_bar(found.objects, desc=f"objects scored by {weights.parent.name}", unit="object"):
        assets, precision = found.assets_of(row), score_precision(row.spec)
        if precision not in judges:
            judges[precision] = detector_of(detector, weights, None, precision)  # type: ignore[arg-type]
        rendered = render_solution(row.spec, row.solution, assets)
        place = rendered.problem, rendered.rendering.points, rendered.theta, row.spec.attack.detection_radius_m
        scores.append((row, score_points(*place, {detector: judges[precision]})[detector].score))
    return _table(scores)


def _table(scores: Sequence[tuple[SweepObject, float]]) -> pa.Table:
    rows = [
        {
            "task_id": row.spec.task_id,
            "vehicle": row.spec.vehicle,
            "place": row.place,
            "settings": row.settings,
            "method": row.solution["method"],
            "score": score,
        }
        for row, score in scores
    ]
    return pa.Table.from_pylist(rows, schema=RESCORED)
