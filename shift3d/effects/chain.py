"""Insertion of an object with its effects, in the order of the physics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from shift3d.effects.applicability import NEEDS, effect_named, need_of
from shift3d.effects.base import Cast, CastStep, EffectContext, FootprintStep, Insertion, Returns, ReturnsStep
from shift3d.effects.physics.materials import albedo_of
from shift3d.render.beams import Beams
from shift3d.render.field.object_field import Field, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.implicit import cosine_of_incidence
from shift3d.render.render import render
from shift3d.render.rendering import Rendering
from shift3d.render.settings import RenderSettings
from shift3d.render.solvers.search import WarmStart
from shift3d.scenes.facts import EffectSettings, with_settings
from shift3d.scenes.scene import Scene

NO_RETURN_M = 1e4
"""Distance along the beam at which rows without a return are placed. It lies beyond every detector's grid. The number
and order of rows therefore never change, as incremental inference and files require."""
SCENE_ALBEDO = 0.3
"""Albedo of the scene's own points if the scene has no reflectance."""


@dataclass
class EffectChain:
    """Effects of one task, bound to its scene. `EffectChain.render` takes the place of `render`.

    names: effects in their order. cast: beams as they are cast, the scene's points first.
    """

    names: tuple[str, ...]
    context: EffectContext
    cast: Cast
    _footprints: list[tuple[str, FootprintStep]] = field(default_factory=list)
    _returns: list[tuple[str, ReturnsStep]] = field(default_factory=list)
    _background: Returns | None = None
    _incidence: bool = False

    @staticmethod
    def of(
        names: Sequence[str],
        scene: Scene,
        vehicle: VehicleFrame,
        seed: int,
        settings: EffectSettings,
        heading_rad: float = 0.0,
    ) -> EffectChain:
        """Bind effects (names in `NEEDS`, any order) to a scene. Not differentiable.

        heading_rad: heading of the object at its placement, also its direction of travel.
        Raises InputError: an unknown name.
        """
        scene = with_settings(scene, settings)
        wanted = {name: need_of(name) for name in names}
        ordered = tuple(name for name in NEEDS if name in wanted)
        effects = [effect_named(name) for name in ordered]
        speed = settings.object_speed_m_s
        context = EffectContext(scene, Beams.of_main_sensor(scene), vehicle, seed, speed, heading_rad)
        cast = Cast(context.beams)
        for effect in effects:
            if effect.kind == "cast":
                step: CastStep = effect.bind(context)  # type: ignore[assignment]
                cast = step(cast)
                context = replace(context, beams=cast.beams)
        chain = EffectChain(ordered, context, cast)
        chain._incidence = any(effect.reads_incidence for effect in effects)
        on_scene: list[ReturnsStep] = []
        for effect in effects:
            if effect.kind == "footprint":
                chain._footprints.append((effect.name, effect.bind(context)))  # type: ignore[arg-type]
            elif effect.kind == "returns":
                bound: ReturnsStep = effect.bind(context)  # type: ignore[assignment]
                chain._returns.append((effect.name, bound))
                if effect.on_scene(context):
                    on_scene.append(bound)
        if on_scene:
            chain._background = chain._scene_returns()
            for bound in on_scene:
                chain._background = bound(chain._background)
        return chain

    @property
    def beams(self) -> Beams:
        """Beams as they are cast."""
        return self.cast.beams

    def render(
        self,
        field: Field,
        theta: Tensor,
        settings: RenderSettings,
        warm: WarmStart | None = None,
        space: SdfGrid | None = None,
    ) -> Rendering:
        """Insert the object and apply every effect. Arguments as in `render.render`.

        The result has a row for every cast beam. Differentiable w.r.t. theta and the field's latent code through the
        points that stay on the object. The loss of a return and hits on anything else carry no gradient.
        """
        vehicle = self.context.vehicle
        core = render(self.beams, field, theta, vehicle, settings, warm, space)
        cast = self.cast
        if not self._footprints and not self._returns and cast.shift_m is None and cast.no_return is None:
            return core  # no effect changes returns, and every row is a point of the scene
        insertion = Insertion(self.beams, core, field, theta, vehicle, settings, cast.shift_m, space)
        spent: dict[str, float] = {}
        returns = self._object_returns(insertion)
        for name, footprint in self._footprints:
            start = time.perf_counter()
            returns = footprint(returns, insertion)
            spent[name] = 1e3 * (time.perf_counter() - start)
        returns = _rows_of(returns, returns.on_object)  # rows that fell back to the scene take no part in the insertion
        for name, step in self._returns:
            start = time.perf_counter()
            returns = step(returns)
            spent[name] = 1e3 * (time.perf_counter() - start)
        return self._merged(core, returns, spent)

    def _object_returns(self, insertion: Insertion) -> Returns:
        """Return the returns on the object before any effect."""
        core, beams = insertion.rendering, self.beams
        row = core.hit_mask.nonzero().squeeze(1)
        cast_points, directions = core.points[row].double(), beams.directions[row]
        # Puts the point on the beam in float64. Gradient and value after rounding to the scene's dtype stay the same.
        exact = beams.origins[row] + core.range_m[row, None] * directions
        cast_points = cast_points + (exact - cast_points).detach()
        cosine = core.grazing.cosine
        if not self._incidence:
            cosine = torch.ones(len(row), dtype=torch.float64)
        elif cosine is None or len(cosine) != len(row):
            cosine = cosine_of_incidence(directions, cast_points, insertion.metric(), insertion.theta)
        albedo = albedo_of(cast_points.detach(), insertion.theta.detach(), insertion.vehicle)
        shift = self.cast.shift_m
        points = cast_points if shift is None else cast_points + shift[row]
        yes = torch.ones(len(row), dtype=torch.bool)
        known = self.context.reflectance
        reflectance = None if known is None else known[row]
        return Returns(row, points, self._origins()[row], directions, yes, yes, cosine, albedo, reflectance)

    def _scene_returns(self) -> Returns:
        """Return the scene's own points as returns; no-return beams have no return."""
        beams, no_return = self.beams, self.cast.no_return
        count = len(beams)
        none = torch.zeros(count, dtype=torch.bool)
        returned = beams.carries if no_return is None else beams.carries & ~no_return
        reflectance = self.context.reflectance
        albedo = torch.full((count,), SCENE_ALBEDO, dtype=torch.float64) if reflectance is None else reflectance
        row, points, ones = (
            torch.arange(count),
            self._points_before_insertion().double(),
            torch.ones(count, dtype=torch.float64),
        )
        return Returns(row, points, self._origins(), beams.directions, none, returned, ones, albedo, reflectance)

    def _points_before_insertion(self) -> Tensor:
        """Return the points (N, 3) before the insertion, dtype of the scene's; no-return beams are placed far away."""
        points = torch.from_numpy(self.context.scene.points)
        extra = torch.arange(len(points), len(self.beams))
        return torch.cat((points, self._far(extra).to(points.dtype)))

    def _merged(self, core: Rendering, returns: Returns, spent: dict[str, float]) -> Rendering:
        """Write the object's rows over the scene's rows. Rows without a return are placed far away."""
        background, resting = self._background, self._points_before_insertion()
        returned = torch.ones(len(resting), dtype=torch.bool)
        if self.cast.no_return is not None:
            returned = ~self.cast.no_return
        range_m = self.beams.ranges_m.clone()
        if background is not None:
            moved = (background.points != resting.double()).any(-1)
            resting = torch.where(moved[:, None], background.points.to(resting.dtype), resting)
            returned = background.returned | ~self.beams.carries
            range_m = torch.where(moved, background.range_m, range_m)
            lost = background.row[~background.returned & self.beams.carries]
            resting = resting.index_copy(0, lost, self._far(lost).to(resting.dtype))
            range_m[lost] = NO_RETURN_M
        far = self._far(returns.row)
        placed = torch.where(returns.returned[:, None], returns.points, far)
        placed_range = torch.where(returns.returned, returns.range_m.detach(), NO_RETURN_M)
        hit_mask = torch.zeros(len(resting), dtype=torch.bool)
        hit_mask[returns.row] = returns.on_object & returns.returned
        reflectance = returns.reflectance
        if reflectance is not None:
            base = self.context.reflectance if background is None else background.reflectance
            assert base is not None
            reflectance = base.index_copy(0, returns.row, reflectance.detach())
        return replace(
            core,
            points=resting.index_copy(0, returns.row, placed.to(resting.dtype)),
            hit_mask=hit_mask,
            range_m=range_m.index_copy(0, returns.row, placed_range),
            returned=returned.index_copy(0, returns.row, returns.returned),
            core=core,
            reflectance=reflectance,
            milliseconds=spent,
        )

    def _far(self, rows: Tensor) -> Tensor:
        return self._origins()[rows] + NO_RETURN_M * self.beams.directions[rows]

    def _origins(self) -> Tensor:
        """Return the beam origins (N, 3) as the sensor knows them."""
        shift = self.cast.shift_m
        return self.beams.origins if shift is None else self.beams.origins + shift


def _rows_of(returns: Returns, kept: Tensor) -> Returns:
    """Select the rows of a mask (K,) bool."""
    if bool(kept.all()):
        return returns
    parts: dict[str, Any] = {name: None if part is None else part[kept] for name, part in vars(returns).items()}
    return Returns(**parts)
