"""How natural a shape is: how far from the nearest vehicle, how usual that is among vehicles, and its sizes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from trimesh.graph import connected_component_labels

from shift3d.errors import InputError
from shift3d.naturalness.calibration import NATURAL_PERCENTILE
from shift3d.naturalness.reference import Nearest, ReferenceSet
from shift3d.naturalness.sizes import Sizes, sizes_of
from shift3d.naturalness.surface import surface_of_mesh, surface_of_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork
    from shift3d.vehicles.vehicle import Vehicle


GAP_M = 0.2
"""Two cells of the grid that a code is decoded on: bars of a roof box, which are thinner than a cell, span less."""
LEAST_PIECE = 0.9
"""Share of a vehicle's surface that hangs together, at least. Our choice: 155 real cars have 0.906 or more."""


@dataclass(frozen=True)
class NaturalnessMeasure:
    """What is measured of one shape; nearest and sizes are None for a code without a surface.

    percentile: share of the reference's left-out members that lie nearer than the shape, see `Calibration.percentile`.
    largest_piece: share of a decoded surface that hangs together, see the function; None for meshes and points, whose
    parts may touch without sharing corners.
    """

    nearest: Nearest | None
    sizes: Sizes | None
    percentile: float
    largest_piece: float | None = None

    @property
    def out_of_range(self) -> tuple[str, ...]:
        """Names of the sizes that no published vehicle has; `largest_piece` where it is less than `LEAST_PIECE`."""
        if self.sizes is None:
            return ()
        loose = self.largest_piece is not None and self.largest_piece < LEAST_PIECE
        return self.sizes.out_of_range() + loose * ("largest_piece",)

    @property
    def natural(self) -> bool:
        """Within the reference's 95th percentile, of a vehicle's sizes, and of one piece."""
        return self.within(NATURAL_PERCENTILE)

    def within(self, percentile: float) -> bool:
        """Whether the shape lies within a percentile, has a vehicle's sizes, and hangs together."""
        return self.sizes is not None and self.percentile <= percentile and not self.out_of_range


NO_SURFACE = NaturalnessMeasure(None, None, 100.0, 0.0)
"""What a code without a surface has."""


class Naturalness:
    """Measures shapes against a reference set. Nothing here is differentiable."""

    def __init__(self, reference: ReferenceSet) -> None:
        self.reference = reference

    def of(self, shape: trimesh.Trimesh | NDArray[np.floating]) -> NaturalnessMeasure:
        """Measure a mesh, or points (N, 3) spread evenly over a surface: x forward, y left, z up, metres, anywhere.

        Raises: InputError for what is no surface: no area, coordinates that are not finite, too few points.
        Source: our choice.
        """
        surface = surface_of_mesh(shape) if isinstance(shape, trimesh.Trimesh) else surface_of_points(shape)
        nearest = self.reference.nearest(surface)
        percentile = self.reference.calibration.percentile(nearest.mean_cm, nearest.p95_cm)
        return NaturalnessMeasure(nearest, sizes_of(surface), percentile)

    def of_code(
        self, vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: ArrayLike | Tensor
    ) -> NaturalnessMeasure:
        """Measure what a vehicle looks like under a code (d,); one without a surface, or not finite, is `NO_SURFACE`.

        Raises: InputError for a code of another length than the vehicle's.
        """
        from shift3d.naturalness.decoded import decoded_mesh

        values = np.asarray(code, np.float32).copy()
        if values.shape != vehicle.latent_code.shape:
            what = f"shape {values.shape}, and {vehicle.name}'s has {vehicle.latent_code.shape}"
            raise InputError(what, where="latent code", remedy="Give a code of the same decoder")
        if not np.isfinite(values).all():
            return NO_SURFACE
        try:
            mesh = decoded_mesh(vehicle, decoder, values)
            return replace(self.of(mesh), largest_piece=largest_piece(mesh))
        except InputError:
            return NO_SURFACE


def largest_piece(mesh: trimesh.Trimesh) -> float:
    """Share of the area in the largest piece; pieces less than `GAP_M` apart, corner from corner, are one."""
    faces, near = np.asarray(mesh.faces), cKDTree(mesh.vertices).query_pairs(GAP_M, output_type="ndarray")
    edges = np.concatenate((faces[:, :2], faces[:, 1:], near))
    piece = connected_component_labels(edges, node_count=len(mesh.vertices))[faces[:, 0]]
    areas = np.bincount(piece, weights=mesh.area_faces)
    return float(areas.max() / areas.sum())
