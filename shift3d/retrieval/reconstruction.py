"""Reconstruction of one crop: the fitted shape, its flags, and the shape as a vehicle."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from shift3d.naturalness.decoded import decoded_surface
from shift3d.retrieval.crops import Crop
from shift3d.retrieval.fit import SHIFT_M, STRETCH, TURN_RAD, Fit, fit_shape, turned
from shift3d.retrieval.subspace import Subspace
from shift3d.vehicles.vehicle import Vehicle

if TYPE_CHECKING:
    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

FLAGS = {
    "one_side": "the points lie along one side of the vehicle at most",
    "wrong_box": "a fourth of the points lie more than 15 cm from the shape, or the shape lies three standard "
    "deviations and more off the box's centre, heading or length",
    "no_surface": "the shape holds no place near its middle",
}
"""Reasons against a reconstruction. Flagged vehicles stay in the table and are never retrieved."""
_MOST_OUTLIERS, _MOST_DEVIATIONS = 0.25, 3.0


@dataclass(frozen=True)
class Reconstruction:
    """Fit of a crop, and its flags, see `FLAGS`."""

    fit: Fit
    flags: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Reconstructor:
    """Fitter of crops. scale_per_length: metres per sdf unit of a vehicle one metre long. sdf_R_object: (3, 3)."""

    subspace: Subspace
    scale_per_length: float
    sdf_R_object: NDArray[np.float64]  # noqa: N815

    def reconstruct(self, crop: Crop) -> Reconstruction:
        """Fit a crop that is not refused. Source: SHIFT3D, supplement; see `fit_shape`."""
        assert not crop.refused
        length_m = float(crop.box[3])
        fit = fit_shape(self.subspace, crop.surface, crop.free, length_m, self.scale_per_length, self.sdf_R_object)
        off = (*np.abs(fit.shift_m) / SHIFT_M, abs(fit.turn_rad) / TURN_RAD)
        off += (abs(np.log(fit.scale_m / (length_m * self.scale_per_length))) / STRETCH,)
        wrong = fit.outliers > _MOST_OUTLIERS or max(off) > _MOST_DEVIATIONS
        solid = bool((self.subspace.field(fit.u)(self._places) < 0.0).any())
        found = {"one_side": len(crop.sides) < 2, "wrong_box": wrong, "no_surface": not solid}
        return Reconstruction(fit, tuple(name for name in FLAGS if found[name]))

    def mean_mesh(self, length_m: float) -> trimesh.Trimesh:
        """Return the mean shape of the known codes at a box's length: the prior for a vehicle without points."""
        mesh = self._mean_surface.copy()
        mesh.vertices = mesh.vertices @ self.sdf_R_object * (length_m * self.scale_per_length)
        return mesh

    @functools.cached_property
    def _mean_surface(self) -> trimesh.Trimesh:
        return self._surface(np.zeros(self.subspace.components))

    def mesh(self, fit: Fit) -> trimesh.Trimesh:
        """Return the shape in the frame of its box, metres. Raises: InputError for a code without a surface."""
        mesh = self._surface(fit.u)
        own = mesh.vertices @ self.sdf_R_object * fit.scale_m
        return trimesh.Trimesh(turned(own, fit.turn_rad) + fit.shift_m, mesh.faces, process=False)

    @functools.cached_property
    def _places(self) -> Tensor:
        """Places near the middle; a valid shape contains some of them."""
        return torch.cartesian_prod(*(torch.linspace(-0.4, 0.4, 5),) * 3)

    def _surface(self, u: NDArray[np.float64]) -> trimesh.Trimesh:
        with torch.no_grad():
            return decoded_surface(self.subspace.field(u))


def vehicle_of(
    name: str,
    decoder: Decoder | DeepSdfNetwork,
    code: NDArray[np.float32],
    scale_m: float,
    sdf_R_object: NDArray[np.float64],
) -> Vehicle:
    """Make a vehicle of a fitted code (d,); the origin is the centre of its decoded box.

    decoder: of the code; the subspace of the fit may come from other vehicles.
    Raises: InputError for a code without a surface.
    """
    vertices = np.asarray(decoded_surface(decoder.field(torch.from_numpy(code))).vertices) @ sdf_R_object
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    length, width, height = (float(side) for side in (high - low) * scale_m)
    centre = sdf_R_object @ ((low + high) / 2)
    return Vehicle(name, code, scale_m, sdf_R_object, centre, (length, width, height))
