"""What MLflow shows of what was done with a sweep's solutions: mean changes of shapes and poses, and scores of kin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from shift3d.analysis.mlflow.client import metric_name
from shift3d.analysis.tables.patterns import pattern_groups
from shift3d.analysis.tables.retrieval import retrieval_groups

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["follow_up_metrics"]


def follow_up_metrics(tables: Mapping[str, pd.DataFrame]) -> dict[str, float]:
    """Metrics of the tables of ``final/`` that `shift3d patterns` and `shift3d retrieve` add; none of those missing.

    ``patterns/<group>/<measure>`` is a mean change over solutions. ``retrieval/<group>/retrieved`` is a mean score, and
    so are ``baseline``, ``shape`` and ``controls`` beside it.
    """
    found: dict[str, float] = {}
    if "patterns" in tables:
        for label, patterns in pattern_groups(tables["patterns"], tables["scores"]):
            found |= {f"patterns/{label}/{part.name} {part.unit}".strip(): part.change.mean for part in patterns}
    if "retrieved" in tables:
        for group in retrieval_groups(tables["retrieved"]):
            title = f"retrieval/{group.label}/{group.scored_by}"
            found |= {f"{title}/{name}": mean for name, mean in group.means.items() if mean == mean}
    return {metric_name(name): value for name, value in found.items()}
