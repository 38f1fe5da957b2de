"""The vehicles that tasks insert: a latent code of the decoder, its metric scale and its place in the object frame."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from shift3d.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

BASELINES = ("coupe", "sports_car", "suv", "convertible", "beach_wagon")
CODE_LENGTH = 256
DEFAULT_VEHICLES = Path(__file__).parent.parent / "weights" / "vehicles.safetensors"


@dataclass(frozen=True)
class Vehicle:
    """A vehicle as the decoder knows it.

    x_sdf = sdf_R_object @ x_object / scale_m + sdf_t_object; a metric distance is scale_m times g.

    Attributes:
        name, body_type: what it is called, and one of the family's body types.
        latent_code: z0, (code,) float32.
        scale_m: metres per sdf unit.
        sdf_R_object: (3, 3) float64 rotation. sdf_t_object: (3,) float64, sdf units.
        size_m: (dx, dy, dz) of the decoded z0 mesh in the object frame, metres; its box's centre is the origin.
    Source: SHIFT3D section "Experiments": five ShapeNet automobiles, "manually scaled" to realistic dimensions.
    """

    name: str
    body_type: str
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


def _read(path: Path | str | None) -> tuple[dict[str, NDArray[np.float32]], dict[str, str], Path]:
    from safetensors import SafetensorError, safe_open

    source = Path(path) if path is not None else DEFAULT_VEHICLES
    if not source.is_file():
        raise InputError("no such file", where=str(source), remedy='train it: make train ARGS="model=sdf"')
    try:
        with safe_open(str(source), framework="np") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}, source  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError(
            f"not a readable safetensors file ({error})", where=str(source), remedy="copy it again"
        ) from error


def _described(metadata: dict[str, str], key: str, source: Path) -> dict[str, dict[str, object]]:
    try:
        described = json.loads(metadata[key])
    except (KeyError, ValueError) as error:
        raise InputError(f"no {key} in its metadata", where=str(source), remedy="a vehicles file of shift3d") from error
    assert isinstance(described, dict)
    return described


def _tensor(
    tensors: dict[str, NDArray[np.float32]], name: str, shape: tuple[int, ...], source: Path
) -> NDArray[np.float32]:
    if name not in tensors:
        raise InputError(f"tensor {name} is missing", where=str(source), remedy=f"expected shape {shape}")
    if tensors[name].shape != shape or not np.isfinite(tensors[name]).all():
        what = f"tensor {name} has shape {tensors[name].shape} or values that are not finite"
        raise InputError(what, where=str(source), remedy=f"expected finite values of shape {shape}")
    return tensors[name].astype(np.float32)


def baseline_vehicles(path: Path | str | None = None) -> dict[str, Vehicle]:
    """The five baselines by name: coupe, sports_car, suv, convertible, beach_wagon.

    Raises: InputError naming the file when it is missing, unreadable or incomplete.
    """
    tensors, metadata, source = _read(path)
    vehicles = {}
    for name, facts in _described(metadata, "baselines", source).items():
        code = _tensor(tensors, f"{name}.latent_code", (CODE_LENGTH,), source)
        size = np.asarray(facts["size_m"], np.float64)
        vehicles[name] = Vehicle(
            name=name,
            body_type=str(facts["body_type"]),
            latent_code=code,
            scale_m=float(str(facts["scale_m"])),
            sdf_R_object=np.asarray(facts["sdf_R_object"], np.float64),
            sdf_t_object=np.asarray(facts["sdf_t_object"], np.float64),
            size_m=(float(size[0]), float(size[1]), float(size[2])),
        )
    return vehicles


def family_vehicles(path: Path | str | None = None) -> list[Vehicle]:
    """Every vehicle that the decoder was trained on, for training detectors: names `<body type>_<index>`.

    Their size_m is that of the mesh they were trained on; decoded, they differ from it by a centimetre or two.
    Raises: InputError as `baseline_vehicles`.
    """
    tensors, metadata, source = _read(path)
    facts = _described(metadata, "family", source)
    types = [str(body_type) for body_type in np.asarray(facts["body_types"])]
    codes = _tensor(tensors, "family.codes", (len(types), CODE_LENGTH), source)
    scales = _tensor(tensors, "family.scale_m", (len(types),), source)
    sizes = _tensor(tensors, "family.size_m", (len(types), 3), source)
    return [
        Vehicle(
            name=f"{body_type}_{index}",
            body_type=body_type,
            latent_code=codes[index],
            scale_m=float(scales[index]),
            sdf_R_object=np.eye(3),
            sdf_t_object=np.zeros(3),
            size_m=(float(sizes[index, 0]), float(sizes[index, 1]), float(sizes[index, 2])),
        )
        for index, body_type in enumerate(types)
    ]


def family_seed(path: Path | str | None = None) -> int:
    """The seed of the family that the decoder was trained on: `family(len(family_vehicles()), seed)` are its meshes."""
    _, metadata, source = _read(path)
    return int(str(_described(metadata, "family", source)["seed"]))


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
