"""Vehicles that tasks insert: latent code, metric scale and the transform between object frame and sdf frame."""

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
"""Smallest side; smallest and largest longest side. Wide enough for the dot or plate that a bad code decodes to."""
LONGEST_SIDE_RADII = (0.2, 4.0)
"""Range of a vehicle's longest side in radii of the decoder's unit sphere; the shipped vehicles have 1.8 to 1.9."""
LARGEST_SCALE_M = LENGTH_M[1]
"""Largest scale: the longest vehicle fills half of its unit sphere. Checking the box of a shape takes 4 s at a scale of
10 m, half a minute at 20 m, and grows with the cube of the scale."""
LARGEST = 100.0  # absolute value in a tensor: codes in the decoder's unit, lengths in metres
MEASURED_RESOLUTION = 129
"""Grid nodes per axis of the unit sphere's cube for measuring a vehicle's box; 257 nodes give the same to 2 mm."""
_ROUNDED_M = 3  # decimals: sizes enter a task's id, and the last bits differ between machines


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as a latent code of a decoder, with its metric scale and pose in the sdf frame.

    x_sdf = sdf_R_object @ x_object / scale_m + sdf_t_object; a metric distance is scale_m times g.

    Attributes:
        name: unique name in the vehicle set.
        latent_code: z0, (code,) float32.
        scale_m: metres per sdf unit.
        sdf_R_object: (3, 3) float64 rotation. sdf_t_object: (3,) float64, sdf units.
        size_m: (dx, dy, dz) of the decoded z0 mesh in the object frame, metres; the box's centre is the origin.
    Source: SHIFT3D section "Experiments": five ShapeNet automobiles, "manually scaled" to realistic dimensions.
    """

    name: str
    latent_code: NDArray[np.float32]
    scale_m: float
    sdf_R_object: NDArray[np.float64]  # noqa: N815
    sdf_t_object: NDArray[np.float64]
    size_m: tuple[float, float, float]

    def to_object(self, x_sdf: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points (N, 3) from the sdf frame to the object frame, metres."""
        return (np.asarray(x_sdf, np.float64) - self.sdf_t_object) @ self.sdf_R_object * self.scale_m

    def to_sdf(self, x_object: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points (N, 3) from the object frame, metres, to the sdf frame."""
        return np.asarray(x_object, np.float64) @ self.sdf_R_object.T / self.scale_m + self.sdf_t_object


def read_tensors(path: Path | str | None) -> tuple[dict[str, NDArray[np.generic]], dict[str, str], Path]:
    """Read tensors, metadata and path of a vehicles file. Raises: InputError if the file is missing or unreadable."""
    return read_safetensors(path, DEFAULT_VEHICLES, "np")


def described(metadata: dict[str, str], key: str, source: Path) -> dict[str, Any]:
    """Return the JSON object stored under a metadata key. Raises: InputError if the key has no JSON object."""
    try:
        found = json.loads(metadata[key])
    except (KeyError, ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise InputError(f"no {key} in its metadata", where=str(source), remedy="Give a vehicles file of shift3d")
    return found


def checked_tensor(
    tensors: dict[str, NDArray[np.generic]], name: str, shape: tuple[int, ...], source: Path
) -> NDArray[np.float32]:
    """Return a tensor by name as float32. Raises: InputError if missing, not finite, or of wrong shape or dtype."""
    if name not in tensors:
        raise InputError(f"tensor {name} is missing", where=str(source), remedy=f"Give it with shape {shape}")
    found = tensors[name]
    usable = found.shape == shape and np.issubdtype(found.dtype, np.floating)
    # NaN fails the comparison.
    if not (usable and bool((np.abs(found) <= LARGEST).all())):
        what = (
            f"tensor {name} is {found.dtype} of shape {found.shape}, or holds values not finite or beyond {LARGEST:g}"
        )
        raise InputError(what, where=str(source), remedy=f"Give finite floating-point values of shape {shape}")
    return found.astype(np.float32)


def _checked(vehicle: Vehicle, source: Path) -> Vehicle:
    """Return the vehicle if its numbers are plausible, else raise InputError. NaN fails every comparison."""
    rotation, size = vehicle.sdf_R_object, np.array(vehicle.size_m)
    wrong = ""
    if not (SIDES_M[0] <= size.min() and SIDES_M[1] <= size.max() <= SIDES_M[2]):
        wrong = f"size_m {vehicle.size_m} is no vehicle's"
    elif not LONGEST_SIDE_RADII[0] * vehicle.scale_m <= size.max() <= LONGEST_SIDE_RADII[1] * vehicle.scale_m:
        wrong = f"scale_m {vehicle.scale_m:g} does not fit a vehicle of {size.max():g} m"
    elif vehicle.scale_m > LARGEST_SCALE_M:
        wrong = f"scale_m {vehicle.scale_m:g} is above {LARGEST_SCALE_M:g}"
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
    """Return `read()`, with an InputError for missing metadata values and values of a wrong type."""
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
    """Load the five baselines by name (coupe, sports_car, suv, convertible, beach_wagon), or those of another file.

    Raises: InputError naming the file when it is missing, unreadable or incomplete, or holds implausible values: an
        invalid transform, a size that contradicts the scale, or values that are not finite.
    """
    tensors, metadata, source = read_tensors(path)
    vehicles = {}
    for name, facts in described(metadata, "baselines", source).items():
        code = checked_tensor(tensors, f"{name}.latent_code", (CODE_LENGTH,), source)
        read = functools.partial(_from_facts, name, facts, code)
        vehicles[name] = _checked(_readable(f"baselines, {name[:80]!r}", source, read), source)
    return vehicles


def family_vehicles(path: Path | str | None = None) -> list[Vehicle]:
    """Load every vehicle that the decoder was trained on, for training detectors. Names are `<body type>_<index>`.

    size_m is the size of the training mesh; the decoded surface differs from it by a centimetre or two.
    Raises: InputError as `baseline_vehicles`.
    """
    tensors, metadata, source = read_tensors(path)
    facts = described(metadata, "family", source)
    types = _readable("family", source, lambda: [str(body_type) for body_type in facts["body_types"]])
    codes = checked_tensor(tensors, "family.codes", (len(types), CODE_LENGTH), source)
    scales = checked_tensor(tensors, "family.scale_m", (len(types),), source)
    sizes = checked_tensor(tensors, "family.size_m", (len(types), 3), source)
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
    """Return the seed of the decoder's training family: `family(len(family_vehicles()), seed)` gives its meshes."""
    _, metadata, source = read_tensors(path)
    facts = described(metadata, "family", source)
    return _readable("family, seed", source, lambda: int(facts["seed"]))


def vehicle_mesh(
    vehicle: Vehicle,
    decoder: Decoder | DeepSdfNetwork,
    z: Tensor | NDArray[np.float32] | None = None,
    resolution: int = 128,
) -> trimesh.Trimesh:
    """Decode the vehicle's surface.

    Args:
        vehicle: gives scale and frame, and z0 if `z` is None.
        z: another code for the same vehicle, e.g. a solution, (code,).
        resolution: grid points along each axis of the unit sphere's cube; 128 points are about 4 cm apart.
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
    """Return low and high corner (3,) of a code's surface, object axes, sdf units. Raises: InputError without one."""
    import torch

    from shift3d.sdf.meshes import extract_mesh

    mesh = extract_mesh(decoder.field(torch.as_tensor(code)), MEASURED_RESOLUTION)
    decoded = np.asarray(mesh.vertices, np.float64) @ sdf_R_object
    return decoded.min(axis=0), decoded.max(axis=0)


def centred_vehicle(
    name: str,
    code: NDArray[np.float32],
    scale_m: float,
    sdf_R_object: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> Vehicle:
    """Build a vehicle with the origin at the centre of the box (low, high) of `decoded_corners`, to the millimetre."""
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
