"""Recipes of detector training: everything that decides the weights, beside the scenes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, pi

from shift3d.detectors.models.backbone import WAYMO_BACKBONE, BackboneSpec
from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pointpillars import PointPillarsNet
from shift3d.detectors.models.sst import SST_SMALL_SPEC, SST_SPEC, SstNet, SstSpec

__all__ = ["RECIPES", "Recipe", "one_cycle", "scaled_to_steps"]


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the trained weights, beside the scenes. Threads are not part of it.

    network: sizes of the detector, which say what it is. steps: optimiser steps; the first `mesh_only_steps`
    use mesh scenes alone, after which each crop comes from a scene with rendered insertions with probability
    `inserted_share`. crop_cells: side of the square crops; batch: crops a step; rim_cells: anchors so close to
    a crop's edge are not trained; jitter_m: how far a crop's centre lies from the vehicle it was chosen for.
    bfloat16: take large products in half the bytes, which pays where the processor has instructions for it.

    grown_from: name of a detector whose shipped weights, doubled in width and depth, are the start; see `growing`.

    settle_steps: steps after those, in which the heads of boxes and directions alone go on, from `settle_rate` down,
    on features as inference has them. In training a batch norm takes the statistics of two crops and not those it
    keeps, and what the heads learn there is off by the difference: PointPillars' boxes were 9 cm too low and flat.
    Scores do not change (our choice).
    """

    network: BackboneSpec | SstSpec = WAYMO_BACKBONE
    grown_from: str = ""
    steps: int = 7000
    settle_steps: int = 500
    settle_rate: float = 5e-4
    mesh_only_steps: int = 2700
    inserted_share: float = 0.5
    mesh_scenes: int = 400
    inserted_scenes: int = 240
    inserted_vehicles: int = 99
    crop_cells: int = 112
    batch: int = 2
    rim_cells: int = 6
    jitter_m: float = 11.0
    peak_rate: float = 1.5e-3
    weight_decay: float = 0.01
    warm_up_share: float = 0.3
    clip_norm: float = 10.0
    direction_weight: float = 0.2
    bfloat16: bool = True
    seed: int = 0

    @property
    def all_steps(self) -> int:
        """Steps with those that settle the heads."""
        return self.steps + self.settle_steps

    @property
    def detector(self) -> str:
        """Name of the detector that these sizes belong to."""
        return self.network.name if isinstance(self.network, SstSpec) else "pointpillars"

    def new_network(self) -> DetectorNet:
        """An untrained network, from torch's global random state."""
        return SstNet(self.network) if isinstance(self.network, SstSpec) else PointPillarsNet(self.network)


RECIPES: dict[str, Recipe] = {
    "pointpillars": Recipe(),
    # Attention costs by the token and the dense layers by the cell, so that small crops around vehicles teach
    # most for the time; weight decay is the published one, the peak rates fit batches of two (our choice). From random
    # weights the published size learns too slowly for two cores: after 4,750 steps at 3e-4 its loss was class 0.53, box
    # 0.45; the small one's was 0.33, 0.37 then.
    "sst": Recipe(
        network=SST_SPEC,
        grown_from="sst_small",
        steps=8_000,
        mesh_only_steps=0,
        crop_cells=64,
        jitter_m=6.0,
        peak_rate=3e-4,
        weight_decay=0.05,
        warm_up_share=0.05,
        direction_weight=1.0,
        settle_rate=1e-4,
    ),
    "sst_small": Recipe(
        network=SST_SMALL_SPEC,
        steps=14_000,
        mesh_only_steps=3_500,
        crop_cells=64,
        jitter_m=6.0,
        peak_rate=5e-4,
        weight_decay=0.05,
        warm_up_share=0.05,
        direction_weight=1.0,
        settle_rate=1e-4,
    ),
}


def one_cycle(step: int, recipe: Recipe) -> tuple[float, float]:
    """(learning rate, first momentum) of a step: cosine up and down again, then down once more for the heads.

    Source: one-cycle as in SECOND's public code (rate from a tenth of the peak, momentum 0.95 to 0.85).
    """
    if step >= recipe.steps:
        part = 0.5 + 0.5 * cos(pi * (step - recipe.steps) / max(1, recipe.settle_steps))
        return recipe.settle_rate * max(part, 1e-4), 0.95
    rise = max(1.0, recipe.warm_up_share * recipe.steps)
    if step < rise:
        part = 0.5 - 0.5 * cos(pi * step / rise)
        return recipe.peak_rate * (0.1 + 0.9 * part), 0.95 - 0.10 * part
    part = 0.5 + 0.5 * cos(pi * min(1.0, (step - rise) / max(1.0, recipe.steps - rise)))
    return recipe.peak_rate * max(part, 1e-4), 0.95 - 0.10 * part


def scaled_to_steps(recipe: Recipe, steps: int) -> Recipe:
    """The recipe with another number of steps, its shares kept; with 0 only the steps that settle the heads."""
    if steps == 0:
        return replace(recipe, steps=0, mesh_only_steps=0)
    share = steps / recipe.steps
    mesh_only, settle = round(recipe.mesh_only_steps * share), round(recipe.settle_steps * share)
    return replace(recipe, steps=steps, mesh_only_steps=mesh_only, settle_steps=settle)
