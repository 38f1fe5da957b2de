"""Scenes and echoes for the hard cases of effects."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from analytic_fields import Frame, in_frame, sphere
from hard_scenes import FAST
from torch import Tensor

from shift3d.effects.base import EffectContext, Returns
from shift3d.effects.chain import EffectChain
from shift3d.effects.weather import fog, precipitation
from shift3d.render import Beams
from shift3d.render.rendering import Rendering
from shift3d.scenes.facts import DetectorFacts, EffectSettings
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel

BALL = Frame(size_m=(2.0, 2.0, 2.0), scale_m=2.5)
BEHIND = torch.tensor([-20.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)
"""A ball that no beam meets: all beams point ahead."""
AHEAD = -BEHIND
"""The same ball, in front of the beams."""
READER = DetectorFacts("reader", reads_reflectance=True)


def scene_of(points: Any, **parts: Any) -> Scene:
    """Return a valid scene of points (N, 3); all beams start at the origin unless `parts` says otherwise."""
    places = np.asarray(points, dtype=np.float32).reshape(-1, 3)
    scene = Scene("hard", "made", places, parts.pop("origins", np.zeros_like(places)), -1.7, **parts)
    scene.validate()
    return scene


def ahead(range_m: float, count: int, **parts: Any) -> Scene:
    """Return `count` beams in +x that return from one range. parts: scene fields; a value per row is repeated."""
    repeated = {name: np.repeat(value, count, 0) if len(value) == 1 else value for name, value in parts.items()}
    return scene_of([[range_m, 0.0, 0.0]] * count, **repeated)


def reported(reflectance: float) -> np.ndarray:
    return np.array([reflectance], np.float32)


def on_object(
    scene: Scene, conditions: Conditions, sensor: SensorModel | None, **parts: float
) -> tuple[EffectContext, Returns]:
    """Return every row of a scene as the object's. parts: cosine, albedo."""
    scene = Scene("hard", "made", scene.points, scene.origins, -1.7, conditions=conditions, sensor=sensor)
    context = EffectContext(scene, Beams.from_scene(scene), BALL, 3)
    beams, yes = context.beams, context.beams.carries
    one = torch.ones(len(beams), dtype=torch.float64)
    light = (parts.get("cosine", 1.0) * one, parts.get("albedo", 0.4) * one, parts.get("albedo", 0.4) * one)
    points = scene_points(scene)
    return context, Returns(torch.arange(len(beams)), points, beams.origins, beams.directions, yes, yes, *light)


def scene_points(scene: Scene) -> Tensor:
    return torch.from_numpy(scene.points).double()


def without_tables() -> None:
    """Clear the tables of fog and rain, so that each run of a case makes its own."""
    fog.fog_echo_table.cache_clear()
    precipitation.crossings.cache_clear()


def finite(returns: Returns) -> None:
    """Check that no value of a return, or of a lost return, is NaN or infinite."""
    for part in (returns.points, returns.cosine, returns.albedo, returns.reflectance):
        assert part is None or torch.isfinite(part).all()


def drawn(scene: Scene, names: list[str], theta: Tensor = BEHIND, **overrides: float) -> Rendering:
    """Render a ball in a scene with these settings."""
    chain = EffectChain.of(names, scene, BALL, 3, EffectSettings(**overrides))
    rendering = chain.render(in_frame(sphere(1.0), BALL), theta, FAST)
    assert torch.isfinite(rendering.points).all() and torch.isfinite(rendering.range_m).all()
    return rendering


def share_returned(rendering: Rendering) -> float:
    assert rendering.returned is not None
    return float(rendering.returned.double().mean())


def within_3_sigma(share: float, expected: float, count: int) -> None:
    assert abs(share - expected) <= 3.0 * math.sqrt(expected * (1.0 - expected) / count), (share, expected)
