"""Later returns of a beam that an inserted surface stops."""

from __future__ import annotations

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep, unchanged
from shift3d.effects.physics.pairing import BeamReturns
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class SecondReturns(Effect):
    """One return a beam from an opaque object: later ones bring nothing back where an earlier one is on it too.

    An insertion moves every return whose beam meets the object; two returns of a beam behind it then lie in the same
    place twice. Of those the earliest stays. Where the object is between two returns, only the later one is on it
    and stays moved: the first passed the beam on in part, the object stops the rest.

    Left as they are: points, reflectance, and every row that is not on the object.

    Differentiable: points that stay keep their gradients; that a row is dropped carries none. It is dropped for good:
    the surface stops the light whether or not its own echo is lost afterwards.

    Source: two returns a beam, an opaque object; pairing by pixel is our choice.
    """

    name = "second_returns"
    kind: Kind = "returns"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Always."""
        return f"{scene.returns} returns a beam: an opaque object in front of them sends back 1"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Rows are paired here, once. Nothing is drawn."""
        paired = BeamReturns.of(context)
        if paired is None:
            return unchanged

        def step(returns: Returns) -> Returns:
            later = returns.on_object & paired.behind(returns.row, returns.on_object)
            return returns.without(later) if bool(later.any()) else returns

        return step


EFFECT = SecondReturns()
