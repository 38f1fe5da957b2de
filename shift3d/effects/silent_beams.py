"""Beams that brought nothing back, and now may meet the object."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from shift3d.effects.base import Cast, CastStep, Kind, Situation
from shift3d.effects.chain import NO_RETURN_M
from shift3d.effects.detector_facts import DetectorFacts
from shift3d.render.beams import Beams
from shift3d.render.field.object_field import VehicleFrame
from shift3d.scenes.facts import SceneFacts
from shift3d.scenes.sensor import SilentBeams

__all__ = ["EFFECT", "SilentBeamsCast"]


class SilentBeamsCast:
    """Rows after the scene's points, one for each beam without a return, in the order of `Scene.silent`.

    They rest `NO_RETURN_M` out and return only where they meet the object. They start in their own places, unless the
    points' beams are all cast from one place that is not their own (several sensors, without the effect `origins`):
    then from that place too. Leaves the rows of the scene's points as they are, bit for bit; without silent beams
    everything. Differentiable: a silent beam that meets the object carries its gradient like any other.
    Source: our choice: the paper moves returns alone.
    """

    name = "silent_beams"
    kind: Kind = "cast"
    reads_incidence = False

    def called_for(self, scene: SceneFacts, vehicle: VehicleFrame, detector: DetectorFacts) -> str | None:
        """See `Effect`. The facts do not tell where the beams point, so any is a reason."""
        return f"{scene.silent_beams} beams without a return may meet the object" if scene.silent_beams else None

    def bind(self, situation: Situation) -> CastStep:
        """See `Effect`."""
        silent = situation.scene.silent
        if silent is None or len(silent) == 0:
            return lambda cast: cast
        own = torch.from_numpy(situation.scene.origins.copy()).double()
        return lambda cast: _with_rows(cast, silent, own)

    def on_scene(self, situation: Situation) -> bool:
        """See `Effect`: no returns step."""
        return False


def _with_rows(cast: Cast, silent: SilentBeams, own: Tensor) -> Cast:
    """The cast with silent rows; own (N, 3): where the points' beams really start."""
    beams, count = cast.beams, len(silent)
    directions = torch.from_numpy(silent.directions.copy()).double()
    directions = directions / directions.norm(dim=-1, keepdim=True)
    origins = torch.from_numpy(silent.origins.copy()).double()
    if not torch.equal(beams.origins, own):
        origins = beams.origins[:1].expand(count, 3)
    places = torch.cat((beams.origins, origins))
    if bool((places == places[:1]).all()):
        places = places[:1].expand(len(places), 3)  # a view of one place is culled faster
    resting = (origins + NO_RETURN_M * directions).to(beams.points.dtype)
    yes = torch.ones(count, dtype=torch.bool)
    rows = Beams(
        torch.cat((beams.points, resting)),
        places,
        torch.cat((beams.directions, directions)),
        torch.cat((beams.ranges_m, torch.full((count,), NO_RETURN_M, dtype=torch.float64))),
        torch.cat((beams.carries, yes)),
    )
    return replace(cast, beams=rows, silent=torch.cat((torch.zeros(len(beams), dtype=torch.bool), yes)))


EFFECT = SilentBeamsCast()
