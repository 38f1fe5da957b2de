"""Where a sweep's vehicles come from: a set of vehicle files, or the codes of a DeepSDF experiment."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.names import WIDE
from shift3d.vehicles.parameter_box import BoxOfParameters, parametric_vehicles, read_parameters
from shift3d.vehicles.vehicle import DEFAULT_VEHICLES, Vehicle, baseline_vehicles, family_vehicles

# A plan asks for names and hashes: what draws vehicles is imported where one is drawn.
if TYPE_CHECKING:
    from torch import Tensor

    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork
    from shift3d.sdf.foreign import Experiment

_T = TypeVar("_T")
MEASURED_RESOLUTION = 129
"""Grid nodes along the unit sphere's cube when a vehicle's box is measured; 257 gives the same to 2 mm."""
_SHORTEST_CODE = 1e-6  # trained codes are some tenths long; shorter ones were never trained
_ROUNDED_M = 3  # decimals: sizes enter a task's id, and machines differ in the last bits


class VehicleSource(Protocol):
    """Vehicles by name, and the decoder that draws them."""

    def names(self) -> list[str]:
        """Every vehicle's name, in a fixed order."""
        ...

    def vehicle(self, name: str) -> Vehicle:
        """One of them. Raises InputError for an unknown name."""
        ...

    def codes(self) -> NDArray[np.float32]:
        """(N, code) of every vehicle that the decoder is known to draw, in a fixed order."""
        ...

    def is_parametric(self, name: str) -> bool:
        """Whether a vehicle's code is made of a generator's parameters."""
        ...

    def parameters(self, name: str) -> BoxOfParameters:
        """What the generator of a vehicle leaves open. Raises InputError where its codes are made of none."""
        ...

    def kinds(self) -> list[str]:
        """The vehicles that a search may turn to. Raises InputError where their sizes take long to measure."""
        ...

    def decoder(self) -> Decoder | DeepSdfNetwork:
        """float32, eval mode, no gradients to its weights. Raises InputError for unusable files."""
        ...

    def decoder_hash(self) -> str:
        """128-bit BLAKE2b, hex, of everything that the decoder's values depend on."""
        ...


def vehicle_hash(vehicle: Vehicle) -> str:
    """128-bit BLAKE2b, hex, of everything that a task reads of a vehicle."""
    digest = hashlib.blake2b(json.dumps([vehicle.name, float(vehicle.scale_m)]).encode(), digest_size=16)
    for array in (vehicle.latent_code, vehicle.sdf_R_object, vehicle.sdf_t_object, vehicle.size_m):
        digest.update(np.asarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def space_hash(source: VehicleSource, vehicle: str, space: str, edited: bool = False) -> str:
    """128-bit BLAKE2b, hex, of what bounds a search beside the vehicle itself; empty for space free.

    edited: the vehicle's parameters are edited, whatever the space.
    Raises: InputError where the vehicle is made of no parameters, and space is parameters or it is edited; for space
    family, where the source's vehicles are no kinds.
    """
    if space == "free" and not edited:
        return ""
    kinds = source.kinds() if space == "family" else []
    parametric = [name for name in kinds if source.is_parametric(name)]
    by_codes = space == "pca" or len(parametric) < len(kinds)
    arrays: tuple[NDArray[Any], ...] = (source.codes(),) if by_codes else ()
    own = [vehicle] if space == "parameters" or edited else []
    for name in parametric if kinds else own:
        box = source.parameters(name)
        arrays += (box.basis, box.start, box.low, box.high)
    digest = hashlib.blake2b(space.encode(), digest_size=16)
    for name in kinds:
        digest.update(vehicle_hash(source.vehicle(name)).encode())
    for array in arrays:
        digest.update(np.asarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def set_folder(folder: Path | str | None, setting: str = "vehicle.folder") -> Path:
    """The folder of a vehicle set; None and "wide" are sets that ship. setting: that named it, for messages."""
    if folder is None:
        return DEFAULT_VEHICLES.parent
    if str(folder) != WIDE:
        return Path(folder).expanduser()
    if (Path(WIDE) / DEFAULT_VEHICLES.name).is_file():
        what = "names the vehicles that ship, and a folder here has the same name"
        raise InputError(what, f"{setting}={WIDE}", "Rename the folder")
    return DEFAULT_VEHICLES.parent / WIDE


class VehicleSet(VehicleSource):
    """A folder with vehicles.safetensors and their decoder, sdf.safetensors.

    None: the five vehicles that ship. "wide": those that ship with a parametric decoder.
    """

    def __init__(self, folder: Path | str | None = None) -> None:
        self._folder = set_folder(folder)

    @functools.cached_property
    def _vehicles(self) -> dict[str, Vehicle]:
        return baseline_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def names(self) -> list[str]:
        return list(self._vehicles)

    def vehicle(self, name: str) -> Vehicle:
        return _known(name, self._vehicles, self._folder)

    def codes(self) -> NDArray[np.float32]:
        return np.stack([found.latent_code for found in family_vehicles(self._folder / DEFAULT_VEHICLES.name)])

    @functools.cached_property
    def _parametric(self) -> frozenset[str]:
        return parametric_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def is_parametric(self, name: str) -> bool:
        return name in self._parametric

    def parameters(self, name: str) -> BoxOfParameters:
        return read_parameters(self._folder / DEFAULT_VEHICLES.name, name)

    def kinds(self) -> list[str]:
        return self.names()

    def decoder(self) -> Decoder:
        from shift3d.sdf.decoder import load_decoder

        return load_decoder(self._folder / "sdf.safetensors")

    def decoder_hash(self) -> str:
        path = self._folder / "sdf.safetensors"
        if not path.is_file():
            remedy = "Give a folder that shift3d fit or shift3d train model=sdf wrote"
            raise InputError("no such file", where=str(path), remedy=remedy)
        return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


class DeepSdfVehicles(VehicleSource):
    """The instances of a DeepSDF experiment, each scaled to a length and measured as the decoder draws it.

    Args:
        folder: in the original layout. checkpoint: "latest", or an epoch.
        forward, up: axes of the sdf frame. The default is ShapeNet's, as pictures of the decoded surfaces show.
        length_m: from nose to tail, of every vehicle, or by the beginning of a name (the longest that fits), with
            "default" for the others. Normalised meshes have no size of their own.
        code_norm: mean length that the experiment's codes are scaled to, the decoder's code columns inversely; None
            leaves them as trained. No shape depends on it, but the attack does: alpha and lambda are in code units, and
            the paper does not say how long its codes are. conf/ has 1.5, our choice. The codes of the 57 real cars are
            0.59 long as trained, and a unit of code then moves their surface by 0.9 m (root mean square), against
            0.35 m for the shipped vehicles: five steps led to twice the code's length off the car. At 1.5 a unit
            moves both kinds of surface alike; it was chosen for that, not by what an attack then reaches.

    Raises: InputError for an axis or a length that cannot be used.
    Source: SHIFT3D, Setup ("manually scaled each baseline object" to realistic dimensions).
    """

    def __init__(
        self,
        folder: Path | str,
        checkpoint: str = "latest",
        forward: str = "-z",
        up: str = "+y",
        length_m: float | Mapping[str, float] = 4.5,
        code_norm: float | None = None,
    ) -> None:
        self._folder = Path(folder).expanduser()
        self._checkpoint, self._code_norm = checkpoint, code_norm
        self._forward, self._up = forward, up
        self._lengths = {"": length_m} if isinstance(length_m, float | int) else dict(length_m)
        self._lengths = {"" if key == "default" else key: float(length) for key, length in self._lengths.items()}
        for length in self._lengths.values():
            MeshFrame(forward, up, length_m=length)
        self._measured: dict[str, Vehicle] = {}

    @functools.cached_property
    def _experiment(self) -> Experiment:
        from shift3d.sdf.foreign import load_experiment

        return load_experiment(self._folder, self._checkpoint)

    @functools.cached_property
    def _code_scale(self) -> float:
        """Factor from codes as trained to codes as used."""
        if self._code_norm is None:
            return 1.0
        mean = float(self._experiment.codes.double().norm(dim=1).mean())
        if mean < _SHORTEST_CODE:
            what = f"its codes are {mean:g} long on average, too short to be scaled to {self._code_norm:g}"
            raise InputError(what, where=str(self._folder), remedy="Give vehicle.code_norm=null, or trained codes")
        return self._code_norm / mean

    @functools.cached_property
    def _scaled(self) -> Decoder | DeepSdfNetwork:
        decoder, factor = self._experiment.decoder, self._code_scale
        return decoder if factor == 1.0 else decoder.with_code_scale(factor)

    def names(self) -> list[str]:
        return list(self._experiment.instances)

    def codes(self) -> NDArray[np.float32]:
        codes: NDArray[np.float32] = (self._experiment.codes * self._code_scale).numpy().astype(np.float32)
        return codes

    def is_parametric(self, name: str) -> bool:
        return False

    def kinds(self) -> list[str]:
        what = "each vehicle of a DeepSDF checkpoint has to be decoded before a search can turn to it"
        raise InputError(what, f"{self._folder}, attack.space=family", "Give attack.space=pca or free")

    def parameters(self, name: str) -> BoxOfParameters:
        what, remedy = "the codes of a DeepSDF checkpoint are made of no parameters", "Give attack.space=pca or free"
        raise InputError(what, f"{self._folder}, attack.space=parameters", remedy)

    def decoder(self) -> Decoder | DeepSdfNetwork:
        """See `VehicleSource`. The same object every time."""
        return self._scaled

    def decoder_hash(self) -> str:
        from shift3d.sdf.foreign import experiment_files

        digest = hashlib.blake2b(repr(self._code_norm).encode(), digest_size=16)
        for path in experiment_files(self._folder, self._checkpoint):
            digest.update(hashlib.blake2b(path.read_bytes(), digest_size=16).digest())
        return digest.hexdigest()

    def vehicle(self, name: str) -> Vehicle:
        """See `VehicleSource`. The first call for a name decodes its surface: some seconds.

        The origin of its object frame is the centre of the decoded box, and its size the box's, to the millimetre.
        """
        if name not in self._measured:
            index = _known(name, {name: i for i, name in enumerate(self.names())}, self._folder)
            code = self._experiment.codes[index] * self._code_scale
            self._measured[name] = self._measure(name, code)
        return self._measured[name]

    def _measure(self, name: str, code: Tensor) -> Vehicle:
        from shift3d.sdf.meshes import extract_mesh

        length_m = self._length_of(name)
        sdf_R_object = MeshFrame(self._forward, self._up, length_m=length_m).object_R_file().T
        mesh = extract_mesh(self._scaled.field(code), MEASURED_RESOLUTION)
        decoded = np.asarray(mesh.vertices, np.float64) @ sdf_R_object
        low, high = decoded.min(axis=0), decoded.max(axis=0)
        self._check_direction(high - low, sdf_R_object, name)
        scale_m = round(float(length_m / (high - low)[0]), 4)
        size = np.round((high - low) * scale_m, _ROUNDED_M)
        centre = np.round((low + high) / 2.0 * scale_m, _ROUNDED_M) / scale_m
        return Vehicle(
            name=name,
            body_type=name.split("_")[0],
            latent_code=code.numpy().astype(np.float32),
            scale_m=scale_m,
            sdf_R_object=sdf_R_object,
            sdf_t_object=sdf_R_object @ centre,
            size_m=(float(size[0]), float(size[1]), float(size[2])),
        )

    def _length_of(self, name: str) -> float:
        fitting = [key for key in self._lengths if name.startswith(key)]
        if not fitting:
            what = f"vehicle.length_m says nothing about {name}"
            raise InputError(what, where=str(self._folder), remedy="Add default=4.5 to it")
        return self._lengths[max(fitting, key=len)]

    def _check_direction(self, extent: NDArray[np.float64], sdf_R_object: NDArray[np.float64], name: str) -> None:
        longest = int(np.argmax(extent))
        if longest != 0:
            axis = "xyz"[int(np.argmax(np.abs(sdf_R_object[:, longest])))]
            what = f"{name} is longest along {axis}, not along vehicle.forward={self._forward}"
            raise InputError(what, where=str(self._folder), remedy=f"Give vehicle.forward=+{axis} or -{axis}")


def _known(name: str, found: Mapping[str, _T], folder: Path) -> _T:
    if name not in found:
        first = ", ".join(list(found)[:12])
        more = f", ... ({len(found)} in all)" if len(found) > 12 else ""
        raise InputError(f"unknown vehicle {name!r}", where=str(folder), remedy=f"Choose from {first}{more}")
    return found[name]
