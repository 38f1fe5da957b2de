"""Naturalness measure of a shape: distance to the nearest vehicle, its percentile among vehicles, and the sizes."""

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
from shift3d.naturalness.reference import NearestMember, ReferenceSet
from shift3d.naturalness.sizes import Sizes, sizes_of
from shift3d.naturalness.surface import surface_of_mesh, surface_of_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork
    from shift3d.vehicles.vehicle import Vehicle


GAP_M = 0.2
"""Two cells of the grid on which codes are decoded. The bars of a roof box, thinner than a cell, span less."""
LEAST_PIECE = 0.9
"""Minimum area share of a vehicle's largest connected piece. Our choice: 155 real cars have 0.906 or more."""


@dataclass(frozen=True)
class NaturalnessMeasure:
    """Measures of one shape; nearest and sizes are None for a code without a surface.

    percentile: percentage of left-out reference members nearer than the shape, see `Calibration.percentile`.
    largest_piece: area share of a decoded surface's largest piece, see the function; None for meshes and points, whose
    parts may touch without shared corners.
    """

    nearest: NearestMember | None
    sizes: Sizes | None
    percentile: float
    largest_piece: float | None = None

    @property
    def out_of_range(self) -> tuple[str, ...]:
        """Names of the sizes outside the published range; `largest_piece` is included if it is below `LEAST_PIECE`."""
        if self.sizes is None:
            return ()
        loose = self.largest_piece is not None and self.largest_piece < LEAST_PIECE
        return self.sizes.out_of_range() + loose * ("largest_piece",)

    @property
    def natural(self) -> bool:
        """True if within the reference's 95th percentile, of a vehicle's sizes, and in one piece."""
        return self.within(NATURAL_PERCENTILE)

    def within(self, percentile: float) -> bool:
        """True if the shape is within a percentile, has a vehicle's sizes, and is in one piece."""
        return self.sizes is not None and self.percentile <= percentile and not self.out_of_range


NO_SURFACE_MEASURE = NaturalnessMeasure(None, None, 100.0, 0.0)  # measure of a code without a surface


class NaturalnessMeter:
    """Naturalness measurement of shapes against a reference set. Not differentiable."""

    def __init__(self, reference: ReferenceSet) -> None:
        self.reference = reference

    def of(self, shape: trimesh.Trimesh | NDArray[np.floating]) -> NaturalnessMeasure:
        """Measure a mesh, or points (N, 3) spread evenly over a surface: x forward, y left, z up, metres, any place.

        Raises: InputError for an invalid surface: no area, coordinates that are not finite, too few points.
        Source: our choice.
        """
        surface = surface_of_mesh(shape) if isinstance(shape, trimesh.Trimesh) else surface_of_points(shape)
        nearest = self.reference.nearest(surface)
        percentile = self.reference.calibration.percentile(nearest.mean_cm, nearest.p95_cm)
        return NaturalnessMeasure(nearest, sizes_of(surface), percentile)

    def of_code(
        self, vehicle: Vehicle, decoder: Decoder | DeepSdfNetwork, code: ArrayLike | Tensor
    ) -> NaturalnessMeasure:
        """Measure a vehicle's surface for a code (d,); a code without surface or not finite gives `NO_SURFACE_MEASURE`.

        Raises: InputError for a code of another length than the vehicle's.
        """
        from shift3d.naturalness.decoded import decoded_mesh

        values = np.asarray(code, np.float32).copy()
        if values.shape != vehicle.latent_code.shape:
            what = f"shape {values.shape}, and {vehicle.name}'s has {vehicle.latent_code.shape}"
            raise InputError(what, where="latent code", remedy="Give a code of the same decoder")
        if not np.isfinite(values).all():
            return NO_SURFACE_MEASURE
        try:
            mesh = decoded_mesh(vehicle, decoder, values)
            return replace(self.of(mesh), largest_piece=largest_piece(mesh))
        except InputError:
            return NO_SURFACE_MEASURE


def largest_piece(mesh: trimesh.Trimesh) -> float:
    """Compute the area share of the largest piece; pieces with corners less than `GAP_M` apart count as one."""
    faces, near = np.asarray(mesh.faces), cKDTree(mesh.vertices).query_pairs(GAP_M, output_type="ndarray")
    edges = np.concatenate((faces[:, :2], faces[:, 1:], near))
    piece = connected_component_labels(edges, node_count=len(mesh.vertices))[faces[:, 0]]
    areas = np.bincount(piece, weights=mesh.area_faces)
    return float(areas.max() / areas.sum())
