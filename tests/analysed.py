"""Handmade results in the form that tables and pages of the analysis take."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from shift3d.analysis.html.blocks import Block, Section
from shift3d.analysis.html.document import document
from shift3d.analysis.variants import Variant

DETECTOR = "pointpillars"


def variant(scores: dict[tuple[str, str], list[float]], mode: str = "shape", **more: Any) -> Variant:
    """Make a variant from scores by (method, vehicle), a score per scene. more: columns by task "vehicle-scene"."""
    more = {"natural": {}, "best_step": {}, **more}
    weight = 1.0 if mode == "shape" else np.nan
    rows = [
        {"task_id": f"{vehicle}-{scene}", "place": f"street/{scene}", "method": method, "vehicle": vehicle}
        | {"score": score, "lambda": weight}
        | {name: values.get(f"{vehicle}-{scene}") for name, values in more.items()}
        for (method, vehicle), values in scores.items()
        for scene, score in enumerate(values)
    ]
    auc = [
        {"method": method, "vehicle": vehicle, "lambda": weight, "auc": float(np.mean(values)), "scores": len(values)}
        for (method, vehicle), values in scores.items()
        if values
    ]
    vehicles = list(dict.fromkeys(vehicle for _, vehicle in scores))
    frame = pd.DataFrame(rows).astype(dict.fromkeys(more, object))
    named: dict[str, Any] = {"mode": mode, "detector": DETECTOR, "scored_by": DETECTOR, "effects": "none"}
    named |= {
        "alpha": 0.01,
        "accuracy": "standard",
        "search": "descent",
        "differing": {},
        "vehicles": vehicles,
        "key": f"{mode}-0",
    }
    return Variant(**named, auc=pd.DataFrame(auc), rows=frame)


def blocks_html(blocks: Sequence[Block]) -> str:
    """Return blocks as a page renders them."""
    return document("", [Section("tested", "", blocks)]).partition("<section")[2].partition("</section>")[0]


def two_vehicles() -> Variant:
    """Make two vehicles in twelve scenes, whose adversarial scores are half of the baseline's."""
    rng = np.random.default_rng(1)
    base = {("baseline", name): list(0.7 + 0.2 * rng.random(12)) for name in ("coupe", "suv")}
    hard = {("adversarial", name): [0.5 * v for v in base["baseline", name]] for name in ("coupe", "suv")}
    return variant(base | hard)
