"""Small handmade catalogues, plans and result rows."""

from __future__ import annotations

from typing import Any

from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.schema.config import Config

BOTH_LAMBDAS = ("attack.lambda=1,10",)
VEHICLES = ("coupe", "sports_car", "suv", "convertible", "beach_wagon")


def catalogue(config: Config) -> Catalogue:
    """Return two scenes and the five vehicles."""
    return Catalogue(
        scenes=tuple(SceneEntry(name, "street-hdl64", name[0], SceneFacts(name)) for name in ("north", "south")),
        scene_arguments={"kind": "street"},
        sector_rad=(0.5, 1.0),
        vehicles={name: f"{name}-hash" for name in VEHICLES},
        decoder_hash="d",
        detectors={config.detector.name: "p"},
        accuracy={"step_m": 0.02},
    )


def score_row(
    task: Any, sweep: str, method: str, score: float | None, loss: float | None = None, **more: Any
) -> dict[str, Any]:
    """Return one row of scores of a planned task."""
    spec = task.spec
    names = ("task_id", "vehicle", "scene", "dataset", "mode", "alpha", "detector", "accuracy", "search")
    row = {name: getattr(spec, name) for name in names} | {"sweep": sweep, "lambda": spec.lambda_}
    row |= {"scored_by": spec.detector, "method": method, "replicate": 0, "effects": [], "status": "ok"}
    return {**row, "score": score, "adversarial_loss": loss, "x_m": 15.0, "y_m": -5.0, **more}
