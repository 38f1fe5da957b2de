"""Is a shape still a car? A coarse look at its outline: one piece, sides, volume, and two halves that match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates

from shift3d.errors import InputError

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork
    from shift3d.vehicles.vehicle import Vehicle

__all__ = ["CAR_RULE", "MIRRORED", "ONE_PIECE", "SIDES", "VOLUMES", "Outline", "outline", "volume_m3"]

ONE_PIECE = 0.97
"""Share of the surface that belongs to the largest piece of one that counts as a single piece."""
SIDES = (0.75, 1.35)
"""How short and how long each side may be, of the baseline's."""
VOLUMES = (0.8, 1.35)
"""How small and how large the volume may be, of the baseline's. Sides alone let a car pass that has lost half of it."""
MIRRORED = 0.95
"""Share of the volume with its mirror image inside as well. The shipped vehicles have 0.99. Of a hundred shapes that
attacks found the eight hardest of those that passed were looked at: with 0.7 and 0.9 in place of these two numbers two
of them were wrecks, with these none."""
CAR_RULE = (
    f"one piece, sides {SIDES[0]:g} to {SIDES[1]:g} and volume {VOLUMES[0]:g} to {VOLUMES[1]:g} of the baseline's, "
    f"{100 * MIRRORED:g} % of it mirrored on the other side"
)
"""The rule in words, for tables."""
RESOLUTION = 64
"""Grid of the mesh that is looked at, about 8 cm: a third of the time of 4 cm, which told six attacked shapes' sides
differently by 0.3 % at most."""


@dataclass(frozen=True)
class Outline:
    """What a shape looks like beside its baseline.

    size_m: (dx, dy, dz), None for a code without a surface. largest_piece: share of the surface, 0 without one.
    sides, volume: over the baseline's. mirrored: share of the volume whose mirror image about the shape's own middle
    plane lies inside too, 0 without a surface.
    """

    size_m: tuple[float, float, float] | None
    largest_piece: float
    sides: tuple[float, ...]
    volume: float
    mirrored: float

    @property
    def still_a_car(self) -> bool:
        """Whether it is one piece, near the baseline's sides and volume, and its halves match. A shape that passes may
        be broken all the same; one that fails is no car."""
        whole = self.size_m is not None and self.largest_piece >= ONE_PIECE and self.mirrored >= MIRRORED
        near = all(SIDES[0] <= side <= SIDES[1] for side in self.sides) and VOLUMES[0] <= self.volume <= VOLUMES[1]
        return whole and near


def outline(
    vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: NDArray[np.float32], baseline_m3: float
) -> Outline:
    """Look at the shape that a vehicle has under another code (d,). baseline_m3: its own, see `volume_m3`.

    Source: our choice: the paper shows shapes and measures none.
    """
    try:
        mesh, values = _decoded(vehicle, decoder, code)
    except InputError:
        return Outline(None, 0.0, (), 0.0, 0.0)
    areas = [float(part.area) for part in mesh.split(only_watertight=False)]
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    length, width, height = (float(side) for side in high - low)
    sides = tuple(side / own for side, own in zip((length, width, height), vehicle.size_m))
    mirrored = _mirrored(vehicle, values, float(low[1] + high[1]) / 2)
    return Outline((length, width, height), max(areas) / sum(areas), sides, float(mesh.volume) / baseline_m3, mirrored)


def volume_m3(vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork) -> float:
    """Volume of the unchanged vehicle. Raises: InputError when its code decodes to no surface."""
    return float(_decoded(vehicle, decoder, vehicle.latent_code)[0].volume)


def _decoded(
    vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: NDArray[np.float32]
) -> tuple[trimesh.Trimesh, NDArray[np.float32]]:
    """The mesh in the object frame, and the values on the grid that it was made from."""
    import torch

    from shift3d.sdf.meshes import field_on_grid, zero_surface

    values, step = field_on_grid(decoder.field(torch.tensor(code)), RESOLUTION)
    mesh = zero_surface(values, step)
    mesh.vertices = vehicle.to_object(np.asarray(mesh.vertices))
    return mesh, values


def _mirrored(vehicle: Vehicle, values: NDArray[np.float32], middle_m: float) -> float:
    """Share of the grid's inner nodes whose mirror image about y = middle_m, object frame, is inside too."""
    from shift3d.sdf.meshes import HALF_EXTENT

    nodes_a_unit = (len(values) - 1) / (2 * HALF_EXTENT)
    inner = np.argwhere(values < 0.0)
    places = vehicle.to_object(inner / nodes_a_unit - HALF_EXTENT)
    places[:, 1] = 2 * middle_m - places[:, 1]
    opposite = (vehicle.to_sdf(places) + HALF_EXTENT) * nodes_a_unit
    found = map_coordinates(values, opposite.T, order=1, mode="nearest")
    return float((found < 0.0).mean()) if len(inner) else 0.0
