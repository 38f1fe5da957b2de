"""What an effect is: when a scene calls for it, and what it does to beams or to what they bring back.

Three kinds, in the order of the physics:

cast        changes from where and in which directions beams meet the object; once for an attack.
footprint   looks at more than a beam's axis; after each insertion, on the beams that need it.
returns     changes what comes back; on the beams that an insertion touched, and once on the whole scene where the
            effect is not in the scene's own points yet.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from shift3d.render.beams import Beams
from shift3d.render.field.object_field import Field, ObjectField, VehicleFrame
from shift3d.render.field.sdf_grid import SdfGrid
from shift3d.render.rendering import Rendering
from shift3d.render.settings import RenderSettings
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Scene
from shift3d.seeding import generator

Kind = Literal["cast", "footprint", "returns"]


@dataclass(frozen=True)
class EffectContext:
    """What stays the same over an attack.

    Attributes:
        scene: as the settings describe it (weather, sensor).
        beams: as they are cast, see `Cast`; N rows, the scene's points first.
        vehicle: frame and size of the object.
        seed: of everything random.
        object_speed_m_s: of the object, along its heading.
        heading_rad: of the object where it was placed, counter-clockwise from the scene's +x.
    """

    scene: Scene
    beams: Beams
    vehicle: VehicleFrame
    seed: int
    object_speed_m_s: float = 0.0
    heading_rad: float = 0.0

    @functools.cached_property
    def reflectance(self) -> Tensor | None:
        """(N,) float64 of the scene's points, 0 of rows beyond them; None where the scene has none."""
        values = self.scene.reflectance
        if values is None:
            return None
        known = torch.from_numpy(values).double()
        return torch.cat((known, known.new_zeros(len(self.beams) - len(known))))

    def draws(self, effect: str, what: str = "") -> np.random.Generator:
        """A fresh generator of one effect's randomness.

        Draw one value for EVERY row of `beams`, then pick: so that a beam gets the same draw on whatever it meets,
        and neither the order of tasks nor the number of hits changes anything.
        """
        return generator("effect", effect, what, self.seed)


@dataclass(frozen=True)
class Cast:
    """How beams meet the object.

    Attributes:
        beams: N rows; rows beyond the scene's points are beams that had no return, resting `NO_RETURN_M` out.
        shift_m: (N, 3) float64 or None: by how much the object is displaced, scene frame, at the time that the beam
            fires. The beams that are cast are displaced the other way; hits are moved back by it.
        no_return: (N,) bool or None: rows without a return unless they meet the object.
    """

    beams: Beams
    shift_m: Tensor | None = None
    no_return: Tensor | None = None


@dataclass(frozen=True)
class Returns:
    """What some beams bring back, K rows.

    Attributes:
        row: (K,) int64, rows of `EffectContext.beams`, ascending.
        points: (K, 3) float64, scene frame, metres; differentiable where on the object.
        origins, directions: (K, 3) float64, of the beams as the sensor knows them (unit directions).
        on_object: (K,) bool: from the inserted object. Not the scene's own.
        returned: (K,) bool: whether anything comes back. Rows without a return keep their place and are ignored.
        cosine: (K,) float64 in [0, 1], of incidence: on the object that of the axis with its surface; 1 elsewhere,
            where it is unknown (and contained in the albedo).
        albedo: (K,) float64 in [0, 1]: on the object by its material, elsewhere the scene's reflectance, or 0.3
            where it has none (our choice: asphalt 0.1 to 0.2, paint up to 0.7).
        reflectance: (K,) float64 in [0, 1], as the sensor reports it; None where the scene has none.
    """

    row: Tensor
    points: Tensor
    origins: Tensor
    directions: Tensor
    on_object: Tensor
    returned: Tensor
    cosine: Tensor
    albedo: Tensor
    reflectance: Tensor | None = None

    def __len__(self) -> int:
        return int(self.row.shape[0])

    @property
    def range_m(self) -> Tensor:
        """(K,) float64 along the beam; differentiable like the points."""
        offset = (self.points - self.origins) * self.directions
        return offset[:, 0] + offset[:, 1] + offset[:, 2]  # in a third of the time of a sum over rows of three

    def moved_to(self, range_m: Tensor, places: Tensor) -> Returns:
        """With other ranges (M,) at places (M,) int64 among the rows; points elsewhere stay bit for bit."""
        moved = self.origins[places] + range_m[:, None] * self.directions[places]
        return replace(self, points=self.points.index_copy(0, places, moved)) if len(places) else self

    def without(self, rows: Tensor) -> Returns:
        """Nothing comes back where rows (K,) bool says so."""
        return replace(self, returned=self.returned & ~rows)


@dataclass(frozen=True)
class Insertion:
    """One object as it has just been inserted.

    Attributes:
        beams: as they were cast. rendering: the first hits of their axes. field: of the object, `settings.dtype`.
        theta: (6,) pose, scene frame, at the time that the scene belongs to. vehicle, settings: as in `render`.
        shift_m: of the cast, see `Cast`. space: of this very field, where there is one.
    """

    beams: Beams
    rendering: Rendering
    field: Field
    theta: Tensor
    vehicle: VehicleFrame
    settings: RenderSettings
    shift_m: Tensor | None = None
    space: SdfGrid | None = None

    def metric(self) -> ObjectField:
        """The object's metric field, object frame."""
        return ObjectField.of(self.field, self.vehicle, self.settings.dtype, self.settings.batch)


CastStep = Callable[[Cast], Cast]
FootprintStep = Callable[[Returns, Insertion], Returns]
ReturnsStep = Callable[[Returns], Returns]


class Effect(ABC):
    """One effect: a module of this package named like it has one as ``EFFECT``.

    kind: see the package. name: as settings have it. reads_incidence: whether `bind`'s step looks at `Returns.cosine`,
    which costs a gradient of the field at every hit.
    """

    name: str
    kind: Kind
    reads_incidence: bool = False

    @abstractmethod
    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Why this scene calls for the effect, in a few words with figures; None where it does not.

        Asked only where the scene, and the detector, have what the effect needs (`effects.applicability.NEEDS`).
        """

    @abstractmethod
    def bind(self, context: EffectContext) -> CastStep | FootprintStep | ReturnsStep:
        """The effect in one context: a step of its kind. Whatever is random is drawn here.

        A step leaves what it does not change as it is, bit for bit; at zero strength that is everything.
        """

    def on_scene(self, context: EffectContext) -> bool:
        """Whether a returns step is to be taken on the scene's own points too, in which most effects are already."""
        return False


class WeatherEffect(Effect):
    """What happens on the way of the light: to the scene's own points too, where they are those of clear, dry air."""

    kind: Kind = "returns"
    reads_incidence = True

    def on_scene(self, context: EffectContext) -> bool:
        return not context.scene.conditions.weather_in_points


def unchanged(returns: Returns) -> Returns:
    """The step of an effect that has no strength."""
    return returns
