"""A vehicle in its object frame, measured as the decoder draws it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shift3d.vehicles.vehicle import Vehicle

if TYPE_CHECKING:
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

MEASURED_RESOLUTION = 129
"""Grid nodes along the unit sphere's cube when a vehicle's box is measured; 257 gives the same to 2 mm."""
_ROUNDED_M = 3  # decimals: sizes enter a task's id, and machines differ in the last bits


def decoded_corners(
    code: NDArray[np.float32] | Tensor, decoder: Decoder | DeepSdfNetwork, sdf_R_object: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Low and high corner (3,) of a code's surface along the object's axes, sdf units.

    Raises: InputError when the code decodes to no surface.
    """
    import torch

    from shift3d.sdf.meshes import extract_mesh

    mesh = extract_mesh(decoder.field(torch.as_tensor(code)), MEASURED_RESOLUTION)
    decoded = np.asarray(mesh.vertices, np.float64) @ sdf_R_object
    return decoded.min(axis=0), decoded.max(axis=0)


def framed(
    name: str,
    body_type: str,
    code: NDArray[np.float32],
    scale_m: float,
    sdf_R_object: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> Vehicle:
    """A vehicle whose object frame has its origin in the centre of its box, to the millimetre.

    low, high: see `decoded_corners`.
    """
    size = np.round((high - low) * scale_m, _ROUNDED_M)
    centre = np.round((low + high) / 2.0 * scale_m, _ROUNDED_M) / scale_m
    return Vehicle(
        name=name,
        body_type=body_type,
        latent_code=code,
        scale_m=scale_m,
        sdf_R_object=sdf_R_object,
        sdf_t_object=sdf_R_object @ centre,
        size_m=(float(size[0]), float(size[1]), float(size[2])),
    )
