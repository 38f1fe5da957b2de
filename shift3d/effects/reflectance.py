"""Reflectance of the object's points, which otherwise report that of the surface behind the object."""

from __future__ import annotations

from dataclasses import replace

import torch

from shift3d.effects.base import Effect, EffectContext, Kind, Returns, ReturnsStep
from shift3d.scenes.facts import DetectorFacts, SceneFacts


class Reflectance(Effect):
    """Reflectance of the object's rows: albedo * cosine of incidence.

    Convention: reflectance is the echo's power times range squared, scaled so that a white diffuse (Lambertian) surface
    at normal incidence reports 1. Sensors correct their reading for range, which they measure, but not for incidence,
    which they do not know. Loaders scale the reading to 0..1.

    No speckle: scenes state none. Only the procedural streets have it (0.25 in factors of e, with the square root of
    the cosine); in any other scene it would be an artefact. As for range noise: if a scene does not state it, it is not
    added. Retroreflectors (plates, lamps), which report more than 1, are left out.

    Leaves unchanged: points, the set of rows with a return, and the reflectance of rows that are not on the object.

    Not differentiable: albedo and cosine are constants; no gradient reaches pose or code. Source: Lambert's law; our
    choice of convention.
    """

    name = "reflectance"
    kind: Kind = "returns"
    reads_incidence = True

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Return the reason. The effect always applies."""
        return f"{detector.name} reads reflectance: moved points would report what they met before"

    def bind(self, context: EffectContext) -> ReturnsStep:
        """Return the step. Draws nothing."""
        return _reported


def _reported(returns: Returns) -> Returns:
    if returns.reflectance is None:
        return returns
    on_object = (returns.albedo * returns.cosine).detach()
    return replace(returns, reflectance=torch.where(returns.on_object, on_object, returns.reflectance))


EFFECT = Reflectance()
