"""Reflectance of the object's points, which otherwise keep that of what lay behind the object."""

from __future__ import annotations

from dataclasses import replace

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class Reflectance(Effect):
    """albedo * cosine of incidence, on the object's rows.

    Convention: reflectance is the echo's power times range squared, scaled so that a white diffuse (Lambertian)
    surface met head on reports 1. Sensors correct their reading for range, which they measure, and not for
    incidence, which they do not know; loaders scale it to 0..1.

    No speckle: scenes state none, and a spread that only the procedural streets have (0.25 in factors of e, with the
    square root of the cosine) would be a trace of its own in any other scene. The same rule as for range noise: what
    a scene does not state is not added. Retroreflectors (plates, lamps), which report more than 1, are left out.

    Left as they are: points, which rows return, and the reflectance of every row that is not on the object.

    Not differentiable: albedo and cosine are constants, and so is the result; no gradient reaches pose or code.

    Source: Lambert's law; our choice of convention.
    """

    name = "reflectance"
    kind: Kind = "returns"
    reads_incidence = True

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Always."""
        return f"{detector.name} reads reflectance: moved points would report what they met before"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Nothing is drawn."""
        return _reported


def _reported(returns: Returns) -> Returns:
    if returns.reflectance is None:
        return returns
    on_object = (returns.albedo * returns.cosine).detach()
    return replace(returns, reflectance=torch.where(returns.on_object, on_object, returns.reflectance))


EFFECT = Reflectance()
