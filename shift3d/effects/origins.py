"""Beam origins at each sensor's own position."""

from __future__ import annotations

from dataclasses import replace

from shift3d.effects.base import CastStep, Effect, EffectContext, Kind
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class Origins(Effect):
    """Start of every beam at the position of its own sensor, or of its own pixel's pose: `Scene.origins`, row by row.

    Without this effect all beams start at the scene's origin, as from one sensor (`Beams.of_main_sensor`). The returns
    and their order stay the same. If all beams share one origin already, nothing changes, bit for bit. Constant:
    gradients are those of the first hits of the cast beams. Source: design section 6.
    """

    name = "origins"
    kind: Kind = "cast"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Return a reason at any distance between the origins: the facts do not contain the distance."""
        return "its beams start in more than 1 place"

    def bind(self, context: EffectContext) -> CastStep:
        scene = context.scene
        if bool((scene.origins == scene.origins[:1]).all()):
            return lambda cast: cast
        return lambda cast: replace(cast, beams=Beams.from_scene(scene))


EFFECT = Origins()
