"""Beams in weather, and their returns before the weather."""

import numpy as np
import torch
from analytic_fields import Frame

from shift3d.effects.base import EffectContext, Returns
from shift3d.render.beams import Beams
from shift3d.scenes.scene import Conditions, Scene
from shift3d.scenes.sensor import SensorModel

COUNT = 40_000


def context_of(conditions: Conditions, sensor: SensorModel | None = None, seed: int = 4) -> EffectContext:
    """Return beams that end 1.5 to 100 m away, in all directions."""
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((COUNT, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = (rng.uniform(1.5, 100.0, (COUNT, 1)) * directions).astype(np.float32)
    scene = Scene("made", "made", points, np.zeros((COUNT, 3), np.float32), -1.7, conditions=conditions, sensor=sensor)
    return EffectContext(scene, Beams.from_scene(scene), Frame(), seed)


def returns_of(
    context: EffectContext, range_m: float | None = None, albedo: float | torch.Tensor = 0.5, cosine: float = 1.0
) -> Returns:
    """Return every beam on the object, at one range or at the beams' ends."""
    beams, one = context.beams, torch.ones(COUNT, dtype=torch.float64)
    yes = torch.ones(COUNT, dtype=torch.bool)
    reach = beams.ranges_m if range_m is None else range_m * one
    points = beams.origins + reach[:, None] * beams.directions
    return Returns(
        torch.arange(COUNT), points, beams.origins, beams.directions, yes, yes, cosine * one, albedo * one, 0.5 * one
    )


def rows_of(returns: Returns, rows: torch.Tensor) -> Returns:
    return Returns(**{name: None if part is None else part[rows] for name, part in vars(returns).items()})


def assert_same(one: Returns, other: Returns) -> None:
    for name, part in vars(one).items():
        assert torch.equal(part, vars(other)[name]), name
