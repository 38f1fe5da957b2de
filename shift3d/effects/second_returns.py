"""Removal of later returns of a beam that the inserted object stops."""

from __future__ import annotations

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.effects.physics.pairing import BeamReturns
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class SecondReturns(Effect):
    """Removal of a beam's later returns on the opaque object if an earlier return is on the object too.

    An insertion moves every return whose beam hits the object, so that two returns from behind the object coincide on
    it. The earliest stays. If the object lies between two returns, only the later one is on it and stays moved: the
    first surface lets part of the beam pass, and the object stops the rest.

    Leaves unchanged: points, reflectance, and every row that is not on the object.

    Differentiable: kept points keep their gradients; the removal of a row carries none. A removed row stays removed:
    the surface stops the light even if another effect loses the surface's own echo later. Source: two returns a beam,
    an opaque object; pairing by pixel is our choice.
    """

    name = "second_returns"
    kind: Kind = "returns"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Return the reason. The effect always applies."""
        return f"{scene.returns} returns a beam: an opaque object in front of them sends back 1"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Pair the rows, once. Draws nothing."""
        paired = BeamReturns.of(context)
        if paired is None:
            return unchanged

        def step(returns: Returns) -> Returns:
            later = returns.on_object & paired.behind(returns.row, returns.on_object)
            return returns.without(later) if bool(later.any()) else returns

        return step


EFFECT = SecondReturns()
