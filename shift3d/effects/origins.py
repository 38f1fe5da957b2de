"""Beams from each sensor's own place."""

from __future__ import annotations

from dataclasses import replace

from shift3d.effects.base import CastStep, Effect, EffectContext, Kind
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class Origins(Effect):
    """Every beam starts where its own sensor, or its own pixel's pose, was: `Scene.origins`, row by row.

    Without it all beams start in the scene's origin, as from one sensor (`Beams.of_main_sensor`). Leaves the returns
    and their order as they are; where all beams start in one place already, everything, bit for bit. Constant:
    gradients are those of the first hits on the beams that are cast. Source: design section 6.
    """

    name = "origins"
    kind: Kind = "cast"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Always, however small the distance between the places: the facts do not tell it."""
        return "its beams start in more than 1 place"

    def bind(self, context: EffectContext) -> CastStep:
        scene = context.scene
        if bool((scene.origins == scene.origins[:1]).all()):
            return lambda cast: cast
        return lambda cast: replace(cast, beams=Beams.from_scene(scene))


EFFECT = Origins()
