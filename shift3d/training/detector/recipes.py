"""Recipes of the shipped detectors, changes of a recipe by text options, and the learning rate of each step."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import fields, replace
from math import cos, pi
from typing import Any

from shift3d.detectors.models.sst import SST_SMALL_SPEC, SST_SPEC
from shift3d.errors import InputError
from shift3d.training.detector.recipe import Augmentation, Recipe

# Attention costs per token and dense layers per cell, so small crops around vehicles teach most per second. The weight
# decay is the published one; the peak rates suit batches of two (our choice).
_SST_SMALL = Recipe(
    network=SST_SMALL_SPEC,
    steps=14_000,
    mesh_only_steps=3_500,
    crop_cells=64,
    jitter_m=6.0,
    peak_rate=5e-4,
    weight_decay=0.05,
    warm_up_share=0.05,
    settle_rate=1e-4,
)
# Sizes down to the smallest cars, with proportions of no single family.
_VARIED = Augmentation(pasted=8, object_scale=(0.75, 1.08), object_stretch=(0.88, 1.15))
# Sizes from KITTI's mean car (3.9 x 1.6 x 1.56 m) to beyond the wide family's mean (4.5 x 1.8 x 1.6 m).
_TWO_REGIONS = replace(_VARIED, object_scale=(0.92, 1.05), object_stretch=(0.82, 1.1, 0.86, 1.08, 0.94, 1.12))
_HEADING_TWICE = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0)
# Each of the two pillar detectors starts from the trained backbone of the other.
_PILLARS = Recipe(augmentation=_VARIED, mesh_only_steps=0, code_weights=_HEADING_TWICE)
RECIPES: dict[str, Recipe] = {
    "pointpillars": replace(
        _PILLARS,
        backbone_from="centerpoint",
        batch=8,
        steps=1500,
        settle_steps=60,
        settle_rate=4e-4,
        peak_rate=1.2e-3,
        warm_up_share=0.12,
        seed=1,
    ),
    "centerpoint": replace(
        _PILLARS,
        heads="centres",
        augmentation=_TWO_REGIONS,
        backbone_from="pointpillars",
        batch=16,
        steps=5500,
        settle_steps=100,
        peak_rate=2e-3,
    ),
    # From random weights the published size learns too slowly on two cores: after 4,750 steps at 3e-4 its losses were
    # class 0.53, box 0.45; those of sst_small were 0.33, 0.37 at that step.
    "sst": replace(
        _SST_SMALL,
        network=SST_SPEC,
        grown_from="sst_small",
        steps=16_000,
        mesh_only_steps=0,
        peak_rate=3e-4,
        augmentation=_TWO_REGIONS,
        code_weights=_HEADING_TWICE,
    ),
    "sst_small": _SST_SMALL,
}


def one_cycle(step: int, recipe: Recipe) -> tuple[float, float]:
    """Return (learning rate, first momentum) of a step: a cosine cycle up and down, then a cosine down for the heads.

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
    """Return the recipe with another number of steps in the same proportions; 0 leaves only the steps of the heads."""
    if steps == 0:
        return replace(recipe, steps=0, mesh_only_steps=0)
    share = steps / recipe.steps
    mesh_only, settle = round(recipe.mesh_only_steps * share), round(recipe.settle_steps * share)
    return replace(recipe, steps=steps, mesh_only_steps=mesh_only, settle_steps=settle)


def changed(recipe: Recipe, words: Mapping[str, str]) -> Recipe:
    """Return the recipe with the given fields of it or of its augmentation: {"pasted": "0", "scale": "1,1"}.

    Values are numbers, true or false, or comma-separated numbers for a field of several.
    Raises: InputError for a field that does not exist or that text cannot give, for a value of the wrong type, and for
    what `Recipe.validate` refuses.
    """
    own = _settable(recipe)
    inner = _settable(recipe.augmentation)
    for name in words:
        if name not in own | inner:
            close = difflib.get_close_matches(name, own | inner, n=1)
            hint = f"Did you mean recipe.{close[0]}=? " if close else ""
            remedy = f"{hint}Choose from {', '.join(sorted(own | inner))}"
            raise InputError(f"recipe.{name} is unknown", "train", remedy)
    ours = {name: _parsed(name, text, own[name]) for name, text in words.items() if name in own}
    theirs = {name: _parsed(name, text, inner[name]) for name, text in words.items() if name in inner}
    result = replace(recipe, **ours, augmentation=replace(recipe.augmentation, **theirs))
    return result.validate()


def _settable(record: Recipe | Augmentation) -> dict[str, Any]:
    """Return the fields of plain types with their present values."""
    values = {item.name: getattr(record, item.name) for item in fields(record)}
    return {name: value for name, value in values.items() if isinstance(value, bool | int | float | tuple)}


def _parsed(name: str, text: str, like: Any) -> Any:
    try:
        if isinstance(like, bool):
            return {"true": True, "false": False}[text]
        if isinstance(like, tuple):
            kind = type(like[0])
            return tuple(kind(part) for part in text.split(","))
        return type(like)(text)
    except (ValueError, KeyError):
        example = ",".join(str(part) for part in like) if isinstance(like, tuple) else str(like).lower()
        raise InputError(f"recipe.{name}={text!r}", "train", f"Give a value such as {example}") from None
