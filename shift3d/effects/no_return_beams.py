"""No-return beams that may hit the object."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.effects.base import Cast, CastStep, Effect, EffectContext, Kind
from shift3d.effects.chain import NO_RETURN_M
from shift3d.render.beams import Beams
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.sensor import NoReturnBeams


class NoReturnCast(Effect):
    """One row for each no-return beam after the scene's points, in the order of `Scene.no_return`.

    A no-return beam is placed `NO_RETURN_M` away and returns only if it hits the object. It starts at its own origin,
    with one exception: if the points' beams are all cast from one origin that is not their own (several sensors,
    without the effect `origins`), it starts there too. The rows of the scene's points stay equal bit for bit. A scene
    without no-return beams is unchanged. A no-return beam that hits the object carries its gradient like any other.
    Source: our choice: the paper moves returns alone.
    """

    name = "no_return_beams"
    kind: Kind = "cast"

    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str:
        """Return a reason in every case: the facts do not contain the directions of the beams."""
        return f"{scene.no_return_beams} beams without a return may meet the object"

    def bind(self, context: EffectContext) -> CastStep:
        no_return = context.scene.no_return
        if no_return is None or len(no_return) == 0:
            return lambda cast: cast
        own = torch.from_numpy(context.scene.origins.copy()).double()
        return lambda cast: _with_rows(cast, no_return, own)


def _with_rows(cast: Cast, no_return: NoReturnBeams, own: Tensor) -> Cast:
    """Append the no-return rows to the cast. own (N, 3): true origins of the points' beams."""
    beams, count = cast.beams, len(no_return)
    directions = torch.from_numpy(no_return.directions.copy()).double()
    directions = directions / directions.norm(dim=-1, keepdim=True)
    origins = torch.from_numpy(no_return.origins.copy()).double()
    if not torch.equal(beams.origins, own):
        origins = beams.origins[:1].expand(count, 3)
    places = torch.cat((beams.origins, origins))
    if bool((places == places[:1]).all()):
        places = places[:1].expand(len(places), 3)  # culling is faster with a view of one row
    resting = (origins + NO_RETURN_M * directions).to(beams.points.dtype)
    yes = torch.ones(count, dtype=torch.bool)
    rows = Beams(
        torch.cat((beams.points, resting)),
        places,
        torch.cat((beams.directions, directions)),
        torch.cat((beams.ranges_m, torch.full((count,), NO_RETURN_M, dtype=torch.float64))),
        torch.cat((beams.carries, yes)),
    )
    return replace(cast, beams=rows, no_return=torch.cat((torch.zeros(len(beams), dtype=torch.bool), yes)))


EFFECT = NoReturnCast()
