"""Loss of a batch: class logits at every cell, boxes at the cells that have a vehicle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import torch
from torch import Tensor

from shift3d.detectors.models.network import BoxHeads
from shift3d.training.detector.anchor_objective import AnchorObjective
from shift3d.training.detector.centre_objective import CentreObjective
from shift3d.training.detector.recipe import Recipe

Objective = AnchorObjective | CentreObjective
"""Objective of one kind of heads: targets of a crop, the cells whose box is trained, and the loss."""
OBJECTIVES: dict[str, type[Objective]] = {"anchors": AnchorObjective, "centres": CentreObjective}
"""Objectives by kind of heads, see `pillar_detectors.PILLAR_NETWORKS`."""


def objective_of(recipe: Recipe) -> Objective:
    """Return the objective for the heads of a recipe."""
    return OBJECTIVES[recipe.heads](recipe)


def map_fields(target: Any, change: Callable[[Any], Any]) -> Any:
    """Return targets with `change` applied to every field: moved to a device, or converted to an array."""
    return replace(target, **{item.name: change(getattr(target, item.name)) for item in fields(target)})


def batch_loss(
    objective: Objective, heads: BoxHeads, features: Tensor, targets: Sequence[Any]
) -> tuple[Tensor, dict[str, float]]:
    """Compute the mean loss and its weighted parts. features: (B, C, h, w). Differentiable w.r.t. features and weights.

    Logits and boxes have the weights' precision, whatever that of the features. Boxes are computed at the trained cells
    alone: the backward pass of the heads over all cells took a twelfth of a step.
    """
    parts: dict[str, Tensor] = {}
    positives = 0
    with torch.autocast(features.device.type, enabled=False):
        logits = heads.logits(features.to(heads.classes.weight.dtype)).unbind()
        for own_features, own_logits, target in zip(features.unbind(), logits, targets, strict=True):
            cells = objective.cells(heads, target)
            rows = heads.box_rows_at(own_features, cells)
            for name, part in objective.loss(own_logits, rows, target).items():
                parts[name] = parts.get(name, 0.0) + part / len(targets)
            positives += len(cells)
    shown = {name: float(part.detach()) for name, part in parts.items()}
    total = torch.stack(list(parts.values())).sum()
    return total, {**shown, "positives": positives / len(targets)}
