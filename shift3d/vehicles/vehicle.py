"""The vehicles that tasks insert: a latent code of the decoder, its metric scale and its place in the object frame."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.store.arrays import read_safetensors
from shift3d.vehicles.mesh_frame import LENGTH_M

if TYPE_CHECKING:
    import trimesh
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

_T = TypeVar("_T")
BASELINES = ("coupe", "sports_car", "suv", "convertible", "beach_wagon")
CODE_LENGTH = 256
DEFAULT_VEHICLES = Path(__file__).parent.parent / "weights" / "vehicles.safetensors"
SIDES_M = (0.01, 0.5, LENGTH_M[1])
"""Least side, least and largest longest side: also of what a decoder makes of a bad code, a dot or a plate."""
SPHERES = (0.2, 4.0)
"""A vehicle's longest side in radii of the decoder's unit sphere, which holds it: 1.8 to 1.9 for the shipped ones."""
LARGEST = 100.0  # of a tensor's values: codes in the decoder's unit, metres
MEASURED_RESOLUTION = 129
"""Grid nodes along the unit sphere's cube when a vehicle's box is measured; 257 gives the same to 2 mm."""
_ROUNDED_M = 3  # decimals: sizes enter a task's id, and machines differ in the last bits


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as the decoder knows it.

    x_sdf = sdf_R_object @ x_object / scale_m + sdf_t_object; a metric distance is scale_m times g.

    Attributes:
        name: what it is called.
        latent_code: z0, (code,) float32.
        scale_m: metres per sdf unit.
        sdf_R_object: (3, 3) float64 rotation. sdf_t_object: (3,) float64, sdf units.
        size_m: (dx, dy, dz) of the decoded z0 mesh in the object frame, metres; its box's centre is the origin.
    Source: SHIFT3D section "Experiments": five ShapeNet automobiles, "manually scaled" to realistic dimensions.
    """

    name: str
    latent_code: NDArray[np.float32]
    scale_m: float
    sdf_R_object: NDArray[np.float64]  # noqa: N815
    sdf_t_object: NDArray[np.float64]
    size_m: tuple[float, float, float]

    def to_object(self, x_sdf: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (N, 3) from the sdf frame to the object frame, metres."""
        return (np.asarray(x_sdf, np.float64) - self.sdf_t_object) @ self.sdf_R_object * self.scale_m

    def to_sdf(self, x_object: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (N, 3) from the object frame, metres, to the sdf frame."""
        return np.asarray(x_object, np.float64) @ self.sdf_R_object.T / self.scale_m + self.sdf_t_object


def read_tensors(path: Path | str | None) -> tuple[dict[str, NDArray[np.generic]], dict[str, str], Path]:
    """Tensors and metadata of a vehicles file, and its path. Raises: InputError where it is missing or unreadable."""
    return read_safetensors(path, DEFAULT_VEHICLES, "np")


def described(metadata: dict[str, str], key: str, source: Path) -> dict[str, Any]:
    """The JSON object under a key of the metadata. Raises: InputError where there is none."""
    try:
        found = json.loads(metadata[key])
    except (KeyError, ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"no {key} in its metadata", where=str(source), remedy="Give a vehicles file of shift3d")
    return found


def tensor_of(
    tensors: dict[str, NDArray[np.generic]], name: str, shape: tuple[int, ...], source: Path
) -> NDArray[np.float32]:
    """A tensor by name, float32. Raises: InputError where it is missing, of another shape or kind, or not finite."""
    if name not in tensors:
        raise InputError(f"tensor {name} is missing", where=str(source), remedy=f"Give it with shape {shape}")
    found = tensors[name]
    usable = found.shape == shape and np.issubdtype(found.dtype, np.floating)
    # The comparison is false for NaN.
    if not (usable and bool((np.abs(found) <= LARGEST).all())):
        what = (
            f"tensor {name} is {found.dtype} of shape {found.shape}, or holds values not finite or beyond {LARGEST:g}"
        )
        raise InputError(what, where=str(source), remedy=f"Give finite floating-point values of shape {shape}")
    return found.astype(np.float32)


def _checked(vehicle: Vehicle, source: Path) -> Vehicle:
    """The vehicle itself where its numbers can be one's; every comparison is written so that NaN fails it."""
    rotation, size = vehicle.sdf_R_object, np.array(vehicle.size_m)
    wrong = ""
    if not (SIDES_M[0] <= size.min() and SIDES_M[1] <= size.max() <= SIDES_M[2]):
        wrong = f"size_m {vehicle.size_m} is no vehicle's"
    elif not SPHERES[0] * vehicle.scale_m <= size.max() <= SPHERES[1] * vehicle.scale_m:
        wrong = f"scale_m {vehicle.scale_m:g} does not fit a vehicle of {size.max():g} m"
    elif rotation.shape != (3, 3) or not np.abs(rotation).max() <= 1.1:
        wrong = "sdf_R_object is no matrix of three unit vectors"
    elif not np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-4:
        wrong = "sdf_R_object is no rotation"
    elif not np.linalg.det(rotation) > 0.0:
        wrong = "sdf_R_object is a reflection"
    elif vehicle.sdf_t_object.shape != (3,) or not np.abs(vehicle.sdf_t_object).max() <= 2.0:
        wrong = "sdf_t_object lies outside the decoder's sphere"
    if wrong:
        raise InputError(f"{vehicle.name[:80]!r}: {wrong}", where=str(source), remedy="Give a vehicles file of shift3d")
    return vehicle


def _readable(key: str, source: Path, read: Callable[[], _T]) -> _T:
    """What is read of the metadata; values that are missing or of another type are said as what they are."""
    try:
        return read()
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        what = f"{key} cannot be read ({type(error).__name__}: {str(error)[:120]!r})"
        raise InputError(what, where=str(source), remedy="Give a vehicles file of shift3d") from error


def _from_facts(name: str, facts: Any, code: NDArray[np.float32]) -> Vehicle:
    length, width, height = (float(size) for size in facts["size_m"])
    return Vehicle(
        name=name,
        latent_code=code,
        scale_m=float(facts["scale_m"]),
        sdf_R_object=np.asarray(facts["sdf_R_object"], np.float64),
        sdf_t_object=np.asarray(facts["sdf_t_object"], np.float64),
        size_m=(length, width, height),
    )


def baseline_vehicles(path: Path | str | None = None) -> dict[str, Vehicle]:
    """The five baselines by name: coupe, sports_car, suv, convertible, beach_wagon; or those of another file.

    Raises: InputError naming the file when it is missing, unreadable or incomplete, or holds what cannot be a
        vehicle's: a transform that is none, another size than the decoder draws, values that are not finite.
    """
    tensors, metadata, source = read_tensors(path)
    vehicles = {}
    for name, facts in described(metadata, "baselines", source).items():
        code = tensor_of(tensors, f"{name}.latent_code", (CODE_LENGTH,), source)
        read = functools.partial(_from_facts, name, facts, code)
        vehicles[name] = _checked(_readable(f"baselines, {name[:80]!r}", source, read), source)
    return vehicles


def family_vehicles(path: Path | str | None = None) -> list[Vehicle]:
    """Every vehicle that the decoder was trained on, for training detectors: names `<body type>_<index>`.

    Their size_m is that of the mesh they were trained on; decoded, they differ from it by a centimetre or two.
    Raises: InputError as `baseline_vehicles`.
    """
    tensors, metadata, source = read_tensors(path)
    facts = described(metadata, "family", source)
    types = _readable("family", source, lambda: [str(body_type) for body_type in facts["body_types"]])
    codes = tensor_of(tensors, "family.codes", (len(types), CODE_LENGTH), source)
    scales = tensor_of(tensors, "family.scale_m", (len(types),), source)
    sizes = tensor_of(tensors, "family.size_m", (len(types), 3), source)
    vehicles = [
        Vehicle(
            name=f"{body_type}_{index}",
            latent_code=codes[index],
            scale_m=float(scales[index]),
            sdf_R_object=np.eye(3),
            sdf_t_object=np.zeros(3),
            size_m=(float(sizes[index, 0]), float(sizes[index, 1]), float(sizes[index, 2])),
        )
        for index, body_type in enumerate(types)
    ]
    return [_checked(vehicle, source) for vehicle in vehicles]


def family_seed(path: Path | str | None = None) -> int:
    """The seed of the family that the decoder was trained on: `family(len(family_vehicles()), seed)` are its meshes."""
    _, metadata, source = read_tensors(path)
    facts = described(metadata, "family", source)
    return _readable("family, seed", source, lambda: int(facts["seed"]))


def vehicle_mesh(
    vehicle: Vehicle,
    decoder: Decoder | DeepSdfNetwork,
    z: Tensor | NDArray[np.float32] | None = None,
    resolution: int = 128,
) -> trimesh.Trimesh:
    """The vehicle's decoded surface.

    Args:
        vehicle: gives scale and frame, and z0 where `z` is None.
        z: another code of the same vehicle, e.g. a solution, (code,).
        resolution: grid points along each axis of the unit sphere's cube; 128 is about 4 cm.
    Returns: mesh in the object frame, metres.
    Raises: InputError when the code decodes to no surface.
    """
    import torch

    from shift3d.sdf.meshes import extract_mesh

    code = torch.as_tensor(vehicle.latent_code if z is None else z, dtype=torch.float32).detach()
    mesh = extract_mesh(decoder.field(code), resolution)
    mesh.vertices = vehicle.to_object(np.asarray(mesh.vertices))
    return mesh


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
        latent_code=code,
        scale_m=scale_m,
        sdf_R_object=sdf_R_object,
        sdf_t_object=sdf_R_object @ centre,
        size_m=(float(size[0]), float(size[1]), float(size[2])),
    )
