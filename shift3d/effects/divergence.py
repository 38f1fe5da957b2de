"""Beam divergence: at a silhouette of the object the strongest echo of the beam's cone becomes the return."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from shift3d.effects.base import Effect, EffectContext, FootprintStep, Insertion, Kind, Returns
from shift3d.effects.chain import SCENE_ALBEDO
from shift3d.effects.physics.materials import albedo_of
from shift3d.effects.physics.power import OBJECT_FAR_M, OVERLAP_FROM_M
from shift3d.effects.physics.silhouettes import silhouette_rows, sub_rays
from shift3d.render.beams import Beams
from shift3d.render.implicit import cosine_of_incidence
from shift3d.render.render import render
from shift3d.scenes.facts import DetectorFacts, SceneFacts

PULSE_M = 0.75
"""Echoes of one beam closer together than this distance merge: c t / 2 of a pulse of 5 ns (our choice)."""
SUB_RAY_SHARE = 2.0 / 3.0
"""Angle of the six outer sub-rays, as a share of the cone's half angle. All seven sub-rays have equal weight (our
choice). In a disc cut into a middle and six sectors of equal area, the sectors' centroids lie at 0.70 of the radius."""
LEAST_FOOTPRINT_M = 0.02
"""A cone no wider than this at `OBJECT_FAR_M` counts as a line (our choice: the usual range noise)."""


class Divergence(Effect):
    """Beam divergence. A beam whose cone crosses a silhouette, or touches the object beside the axis, gets 7 sub-rays.

    The renderer casts the axis and a hexagon around it, all of equal weight. Each echo has the power weight * albedo *
    cosine / range^2; nearer than `OVERLAP_FROM_M` it has the power of that range. A sub-ray that misses the object
    meets the beam's former surface, at its range, at normal incidence; a sub-ray of a no-return beam meets nothing.
    Echoes within `PULSE_M` of the next echo merge. The group of most power is the return, at its mean range weighted by
    power. If the object has at least half of that power, the point lies on the axis at that range. Else the row gets
    the scene's point again. If all seven merge on the object, the cone is on one face: the axis's hit stays.

    In changed rows `cosine` is the mean weighted by power, and `albedo` contains the object's share of the cone. Their
    product is the light that the object sends back.

    All other beams stay equal bit for bit; at zero divergence all beams do. Not random. Differentiable w.r.t. pose and
    code through the ranges of the sub-rays. The gradient ignores changes of power and the set of echoes. Source: shared
    physics, Beam divergence; the constants name their own sources.
    """

    name = "divergence"
    kind: Kind = "footprint"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a reason if the cone is wider than `LEAST_FOOTPRINT_M` at the farthest placement."""
        width = OBJECT_FAR_M * (scene.sensor.divergence_rad or 0.0)
        if not width > LEAST_FOOTPRINT_M:
            return None
        return f"a beam is {100.0 * width:.0f} cm wide at {OBJECT_FAR_M:.0f} m"

    def bind(self, context: EffectContext) -> FootprintStep:
        sensor = context.scene.sensor
        if sensor is None or not sensor.divergence_rad:
            return lambda returns, insertion: returns
        return _Footprint(context, SUB_RAY_SHARE * sensor.divergence_rad / 2.0)


def strongest(range_m: Tensor, power: Tensor) -> Tensor:
    """Return the mask (C, S) of the echoes in the group of most power; of equal groups the nearest.

    range_m, power: (C, S). A group ends if the next echo is more than `PULSE_M` farther. Not differentiable.
    """
    ordered, order = range_m.sort(dim=1, stable=True)
    group = torch.nn.functional.pad((ordered.diff(dim=1) > PULSE_M).long().cumsum(1), (1, 0))
    total = torch.zeros_like(power).scatter_add_(1, group, power.gather(1, order))
    best = group == total.argmax(1, keepdim=True)
    return torch.zeros_like(best).scatter_(1, order, best)


@dataclass(frozen=True)
class _ConeReturn:
    """Returns of C beams; all fields (C,).

    object_wins: the return is the object's. whole: the whole cone lies on one face. range_m: differentiable.
    """

    object_wins: Tensor
    whole: Tensor
    range_m: Tensor
    cosine: Tensor
    albedo: Tensor

    @staticmethod
    def of(range_m: Tensor, light: Tensor, cosine: Tensor, on_object: Tensor) -> _ConeReturn:
        """Select the strongest group of merged echoes. Without any power the return is not the object's.

        Args, each (C, 7), for the axis and six sub-rays:
            range_m: differentiable. light: weight * albedo * cosine. cosine: of incidence; 1 off the object.
        """
        # At the sensor itself the receiver sees nothing, but 1 / range^2 has no bound.
        power = light / range_m.detach().clamp_min(OVERLAP_FROM_M).square()
        kept = strongest(range_m.detach(), power)
        ours = kept & on_object
        total, of_object = (power * kept).sum(1), (power * ours).sum(1)
        object_wins = (of_object > 0) & (of_object >= 0.5 * total)
        weight = power * kept / torch.where(object_wins, total, 1.0)[:, None]
        share = power * ours / torch.where(object_wins, of_object, 1.0)[:, None]
        mean_cosine = torch.where(object_wins, (share * cosine).sum(1), 1.0)
        albedo = (light * ours).sum(1) / mean_cosine
        return _ConeReturn(object_wins, ours.all(1), (weight * range_m).sum(1), mean_cosine, albedo)


@dataclass(frozen=True)
class _Footprint:
    """Footprint step. angle_rad: angle between a sub-ray and the axis."""

    context: EffectContext
    angle_rad: float

    def __call__(self, returns: Returns, insertion: Insertion) -> Returns:
        rows = silhouette_rows(insertion, self.angle_rad)
        if len(rows) == 0:
            return returns
        verdict = self._verdict(rows, returns, insertion)
        was_hit = insertion.rendering.hit_mask[rows]
        result = _moved(returns, rows, was_hit & verdict.object_wins & ~verdict.whole, verdict)
        known = rows < len(self.context.scene.points)
        result = self._restored_to_scene(result, rows[was_hit & ~verdict.object_wins & known])
        return self._with_gained(result, rows, ~was_hit & verdict.object_wins, verdict, insertion)

    def _verdict(self, rows: Tensor, returns: Returns, insertion: Insertion) -> _ConeReturn:
        """Cast the sub-rays of rows (C,); the axes are cast already. Differentiable through the ranges."""
        beams, count = insertion.beams, len(rows)
        starts, axis, ends = beams.origins[rows], beams.directions[rows], beams.ranges_m[rows]
        around = sub_rays(axis, self.angle_rad)
        range_m, on_object = _cast(starts, around, ends, insertion)
        on_axis = insertion.rendering.hit_mask[rows]
        own = ends.index_copy(0, on_axis.nonzero().squeeze(1), returns.range_m[_places(returns, rows[on_axis])])
        range_m, on_object = torch.cat((own[:, None], range_m), 1), torch.cat((on_axis[:, None], on_object), 1)
        directions = torch.cat((axis[:, None], around), 1)
        points = (starts[:, None] + range_m.detach()[..., None] * directions)[on_object]
        cosine = torch.ones(count, 7, dtype=torch.float64)
        cosine[on_object] = cosine_of_incidence(directions[on_object], points, insertion.metric(), insertion.theta)
        albedo = self._scene_albedo(rows)[:, None].repeat(1, 7)
        albedo[on_object] = albedo_of(points, insertion.theta.detach(), insertion.vehicle)
        return _ConeReturn.of(range_m, albedo * cosine / 7.0, cosine, on_object)

    def _restored_to_scene(self, returns: Returns, rows: Tensor) -> Returns:
        """Give rows that fell back to the scene their own points."""
        if len(rows) == 0:
            return returns
        place = _places(returns, rows)
        own = torch.from_numpy(self.context.scene.points[rows.numpy()]).double()
        return replace(
            returns,
            points=returns.points.index_copy(0, place, own),
            on_object=returns.on_object.index_fill(0, place, False),
            cosine=returns.cosine.index_fill(0, place, 1.0),
            albedo=returns.albedo.index_copy(0, place, self._scene_albedo(rows)),
        )

    def _with_gained(
        self, returns: Returns, rows: Tensor, gained: Tensor, verdict: _ConeReturn, insertion: Insertion
    ) -> Returns:
        """Add, in row order, the rows whose cone hits the object although their axis misses it."""
        if not bool(gained.any()):
            return returns
        row, shift = rows[gained], insertion.shift_m
        origins, directions = insertion.beams.origins[row], insertion.beams.directions[row]
        origins = origins if shift is None else origins + shift[row]
        points = origins + verdict.range_m[gained, None] * directions
        yes = torch.ones(len(row), dtype=torch.bool)
        known = self.context.reflectance
        reflectance = None if known is None else known[row]
        cosine, albedo = verdict.cosine[gained], verdict.albedo[gained]
        return _together(returns, Returns(row, points, origins, directions, yes, yes, cosine, albedo, reflectance))

    def _scene_albedo(self, rows: Tensor) -> Tensor:
        """Return the albedo (C,) of the surfaces behind the object; 0 for no-return beams."""
        if (known := self.context.reflectance) is not None:
            return known[rows]
        return SCENE_ALBEDO * (rows < len(self.context.scene.points)).double()


def _cast(starts: Tensor, around: Tensor, ends: Tensor, insertion: Insertion) -> tuple[Tensor, Tensor]:
    """Cast sub-rays `around` (C, 6, 3) from `starts` (C, 3) with end ranges `ends` (C,).

    Returns ranges and the mask of hits on the object, (C, 6) each. The ranges are differentiable w.r.t. pose and code.
    """
    count = len(ends)
    origins, directions, ranges = starts.repeat_interleave(6, 0), around.reshape(-1, 3), ends.repeat_interleave(6)
    carries = torch.ones(6 * count, dtype=torch.bool)
    beams = Beams(origins + ranges[:, None] * directions, origins, directions, ranges, carries)
    settings, space = insertion.settings, insertion.space
    found = render(beams, insertion.field, insertion.theta, insertion.vehicle, settings, None, space)
    along = ((found.points - origins) * directions).sum(-1)
    return torch.where(found.hit_mask, along, ranges).reshape(count, 6), found.hit_mask.reshape(count, 6)


def _places(returns: Returns, rows: Tensor) -> Tensor:
    """Find the indices of `rows` in `returns.row`, which must contain all of them."""
    return torch.searchsorted(returns.row, rows)


def _moved(returns: Returns, rows: Tensor, moved: Tensor, verdict: _ConeReturn) -> Returns:
    """Move the rows (C,) of the mask `moved` (C,) to their new ranges."""
    if not bool(moved.any()):
        return returns
    place = _places(returns, rows[moved])
    return replace(
        returns.moved_to(verdict.range_m[moved], place),
        cosine=returns.cosine.index_copy(0, place, verdict.cosine[moved]),
        albedo=returns.albedo.index_copy(0, place, verdict.albedo[moved]),
    )


def _together(returns: Returns, more: Returns) -> Returns:
    """Join the rows of both, ascending."""
    order = torch.cat((returns.row, more.row)).argsort()
    parts: dict[str, Any] = {}
    for name, part in vars(returns).items():
        parts[name] = None if part is None else torch.cat((part, getattr(more, name)))[order]
    return Returns(**parts)


EFFECT = Divergence()
