"""Interface of an effect: a test of its applicability to a scene, and a step that changes beams or returns.

Three kinds of steps, in the order of the physics:

cast        changes the origins and directions in which beams meet the object; runs once for an attack.
footprint   considers a beam's whole cone; runs after each insertion, on the beams that need it.
returns     changes returns; runs on the beams that hit the object, and once on the whole scene if it lacks the effect.
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
    """Data that stay constant over an attack.

    Attributes:
        scene: the scene with the settings (weather, sensor) applied.
        beams: beams as they are cast, see `Cast`; N rows, the scene's points first.
        vehicle: frame and size of the object.
        seed: seed of all random draws.
        object_speed_m_s: speed of the object along its heading.
        heading_rad: heading of the object at its placement, counter-clockwise from the scene's +x.
    """

    scene: Scene
    beams: Beams
    vehicle: VehicleFrame
    seed: int
    object_speed_m_s: float = 0.0
    heading_rad: float = 0.0

    @functools.cached_property
    def reflectance(self) -> Tensor | None:
        """Reflectance (N,) float64 of the scene's points, 0 in rows beyond the points; None if the scene has none."""
        values = self.scene.reflectance
        if values is None:
            return None
        known = torch.from_numpy(values).double()
        return torch.cat((known, known.new_zeros(len(self.beams) - len(known))))

    def draws(self, effect: str, what: str = "") -> np.random.Generator:
        """Return a fresh random generator for one effect.

        Draw one value for EVERY row of `beams`, then select. A beam then gets the same draw whatever the beam meets,
        and the result depends neither on the order of tasks nor on the number of hits.
        """
        return generator("effect", effect, what, self.seed)


@dataclass(frozen=True)
class Cast:
    """Beams as they are cast at the object.

    Attributes:
        beams: N rows. Rows beyond the scene's points are no-return beams; their points lie `NO_RETURN_M` away.
        shift_m: (N, 3) float64 or None: displacement of the object at the beam's firing time, scene frame. Beams are
            cast displaced by -shift_m; hits are moved back by shift_m.
        no_return: (N,) bool or None: rows that have a return only if they meet the object.
    """

    beams: Beams
    shift_m: Tensor | None = None
    no_return: Tensor | None = None


@dataclass(frozen=True)
class Returns:
    """Returns of K beams.

    Attributes:
        row: (K,) int64, rows of `EffectContext.beams`, ascending.
        points: (K, 3) float64, scene frame, metres; differentiable if on the object.
        origins, directions: (K, 3) float64, beam origins and unit directions as the sensor knows them.
        on_object: (K,) bool: the return comes from the inserted object, not from the scene.
        returned: (K,) bool: the beam has a return. Rows without a return keep their place and are ignored.
        cosine: (K,) float64 in [0, 1], cosine of incidence. On the object: between beam axis and surface. Elsewhere: 1,
            because the incidence is unknown (the albedo contains it).
        albedo: (K,) float64 in [0, 1]. On the object: albedo of the material. Elsewhere: the scene's reflectance, or
            0.3 if the scene has none (our choice: asphalt 0.1 to 0.2, paint up to 0.7).
        reflectance: (K,) float64 in [0, 1], as the sensor reports it; None if the scene has none.
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
        """Range (K,) float64 along the beam; differentiable like the points."""
        offset = (self.points - self.origins) * self.directions
        return offset[:, 0] + offset[:, 1] + offset[:, 2]  # takes a third of the time of a sum over rows of three

    def moved_to(self, range_m: Tensor, places: Tensor) -> Returns:
        """Return a copy with ranges (M,) at indices `places` (M,) int64. All other points stay equal bit for bit."""
        moved = self.origins[places] + range_m[:, None] * self.directions[places]
        return replace(self, points=self.points.index_copy(0, places, moved)) if len(places) else self

    def without(self, rows: Tensor) -> Returns:
        """Return a copy in which the rows of the mask (K,) bool have no return."""
        return replace(self, returned=self.returned & ~rows)


@dataclass(frozen=True)
class Insertion:
    """Inserted object after its rendering.

    Attributes:
        beams: the beams as cast. rendering: first hits of the beam axes. field: the object's field, `settings.dtype`.
        theta: (6,) pose at time 0 of the scene, scene frame. vehicle, settings: as in `render`.
        shift_m: see `Cast`. space: SDF grid of this field, or None.
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
        """Return the object's metric field, object frame."""
        return ObjectField.of(self.field, self.vehicle, self.settings.dtype, self.settings.batch)


CastStep = Callable[[Cast], Cast]
FootprintStep = Callable[[Returns, Insertion], Returns]
ReturnsStep = Callable[[Returns], Returns]


class Effect(ABC):
    """One effect. The module of this package with the effect's name defines an instance ``EFFECT``.

    kind: see the module. name: name in the settings. reads_incidence: the step of `bind` reads `Returns.cosine`, which
    costs a gradient of the field at every hit.
    """

    name: str
    kind: Kind
    reads_incidence: bool = False

    @abstractmethod
    def applicability(self, scene: SceneFacts, detector: DetectorFacts) -> str | None:
        """Return a short reason, with figures, for using the effect; None if the scene does not call for it.

        Called only if scene and detector have the data that the effect needs (`effects.applicability.NEEDS`).
        """

    @abstractmethod
    def bind(self, context: EffectContext) -> CastStep | FootprintStep | ReturnsStep:
        """Bind the effect to one context: return a step of its kind. `bind` makes all random draws.

        A step leaves equal bit for bit what it does not change. At zero strength it changes nothing.
        """

    def on_scene(self, context: EffectContext) -> bool:
        """True if a returns step also runs on the scene's own points, which contain most effects already."""
        return False


class WeatherEffect(Effect):
    """Effect along the light path. It also changes the scene's own points if they were recorded in clear, dry air."""

    kind: Kind = "returns"
    reads_incidence = True

    def on_scene(self, context: EffectContext) -> bool:
        return not context.scene.conditions.weather_in_points


def unchanged(returns: Returns) -> Returns:
    """Return the returns unchanged: the step of an effect of zero strength."""
    return returns
