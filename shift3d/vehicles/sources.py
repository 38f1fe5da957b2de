"""Vehicle sources of a sweep: vehicles by name with their decoder. A set of vehicle files is one source."""

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
from shift3d.store.user_cache import cache_file, cache_result, program_digest, read_cached
from shift3d.vehicles.parameter_box import (
    ParameterBox,
    code_of_box,
    kind_and_number,
    parametric_vehicles,
    random_box,
    read_parameters,
)
from shift3d.vehicles.vehicle import (
    DEFAULT_VEHICLES,
    MEASURED_RESOLUTION,
    Vehicle,
    baseline_vehicles,
    centred_vehicle,
    decoded_corners,
    family_vehicles,
)

# A plan needs names and hashes only, so the decoder modules are imported where a vehicle is decoded.
if TYPE_CHECKING:
    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

_T = TypeVar("_T")
WIDE = "wide"
"""Vehicle set of the parametric decoder, in `weights/wide`. A user's folder with this name is ./wide."""


class VehicleSource(Protocol):
    """Interface of a source of vehicles by name, with the decoder that draws them."""

    def names(self) -> list[str]:
        """Return all names in a fixed order. For vehicles drawn from a kind's ranges only the kind is listed."""
        ...

    def vehicle(self, name: str) -> Vehicle:
        """Return a vehicle by name, or one drawn from a parametric kind. Raises: InputError for an unknown name."""
        ...

    def check_size(self, name: str) -> None:
        """Raise InputError if a vehicle's box contradicts its decoded shape. A source that measured the box checks
        nothing."""
        return

    def codes(self) -> NDArray[np.float32]:
        """Return the codes (N, code) of all vehicles that the decoder was trained on, in a fixed order."""
        ...

    def is_parametric(self, name: str) -> bool:
        """True if the vehicle's code is made of a generator's parameters."""
        ...

    def parameters(self, name: str) -> ParameterBox:
        """Return a vehicle's free parameters. Raises: InputError if its code is not made of parameters."""
        ...

    def kinds(self) -> list[str]:
        """Return the vehicles that a search may switch to. Raises: InputError if measuring their sizes is slow."""
        ...

    def decoder(self) -> Decoder | DeepSdfNetwork:
        """Return the decoder, one object per source: float32, eval mode, no weight gradients.

        Raises: InputError for unusable files.
        """
        ...

    def decoder_hash(self) -> str:
        """Compute the 128-bit BLAKE2b, hex, of everything that the decoder's values depend on."""
        ...


def vehicle_hash(vehicle: Vehicle) -> str:
    """Compute the 128-bit BLAKE2b, hex, of all vehicle data that a task reads."""
    digest = hashlib.blake2b(json.dumps([vehicle.name, float(vehicle.scale_m)]).encode(), digest_size=16)
    for array in (vehicle.latent_code, vehicle.sdf_R_object, vehicle.sdf_t_object, vehicle.size_m):
        digest.update(np.asarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def space_hash(source: VehicleSource, vehicle: str, space: str, edited: bool = False) -> str:
    """Compute the 128-bit BLAKE2b, hex, of the bounds of a search beside the vehicle itself; empty for space free.

    edited: the vehicle's parameters are edited, whatever the space.
    Raises: InputError if the vehicle has no parameters and space is parameters or edited is set; for space family, if
    the source has no kinds.
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


def vehicle_set_folder(folder: Path | str | None, setting: str = "vehicle.folder") -> Path:
    """Return the folder of a vehicle set; None and "wide" are shipped sets. setting: its name, for messages."""
    if folder is None:
        return DEFAULT_VEHICLES.parent
    if str(folder) != WIDE:
        return Path(folder).expanduser()
    if (Path(WIDE) / DEFAULT_VEHICLES.name).is_file():
        what = "names the vehicles that ship, and a folder here has the same name"
        raise InputError(what, f"{setting}={WIDE}", "Rename the folder")
    return DEFAULT_VEHICLES.parent / WIDE


class VehicleSet(VehicleSource):
    """Vehicle source of a folder with vehicles.safetensors and their decoder, sdf.safetensors.

    None: the five shipped vehicles. "wide": the shipped vehicles of the parametric decoder. If vehicle NAME is made of
    parameters, NAME-1, NAME-2, ... also exist, drawn at random from its ranges. The first call for a drawn vehicle
    takes two seconds, once per machine.
    """

    def __init__(self, folder: Path | str | None = None) -> None:
        self._folder = vehicle_set_folder(folder)
        self._drawn: dict[str, Vehicle] = {}

    @functools.cached_property
    def _vehicles(self) -> dict[str, Vehicle]:
        return baseline_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def names(self) -> list[str]:
        return list(self._vehicles)

    def _kind(self, name: str) -> tuple[str, int]:
        """Split a name as `kind_and_number`; a vehicle of the folder may have such a name itself."""
        kind, number = kind_and_number(name)
        return (kind, number) if name not in self._vehicles and kind in self._parametric else (name, 0)

    def vehicle(self, name: str) -> Vehicle:
        kind, number = self._kind(name)
        found = known(kind, self._vehicles, self._folder)
        if number and name not in self._drawn:
            code = code_of_box(found.latent_code, self.parameters(kind), self.parameters(name))
            corners = self._corners(code, found.sdf_R_object)
            self._drawn[name] = centred_vehicle(name, code, found.scale_m, found.sdf_R_object, *corners)
        return self._drawn[name] if number else found

    def check_size(self, name: str) -> None:
        """Compare a vehicle of a user's folder with its shape: four seconds, once per vehicle and machine.

        The margin is a node spacing of the measuring grid, 4 cm for a car. The shipped vehicles and those of `fit`
        differ by less than a micrometre from it, and a grid of half as many nodes by 8 mm.
        """
        if self._folder.is_relative_to(DEFAULT_VEHICLES.parent) or self._kind(name)[1]:
            return
        vehicle, file = self.vehicle(name), str(self._folder / DEFAULT_VEHICLES.name)
        remedy = "Put the sdf.safetensors of these vehicles beside it, or make both files again"
        self.decoder()  # the errors of its file come first
        try:
            corners = self._corners(vehicle.latent_code, vehicle.sdf_R_object)
        except InputError as error:
            raise InputError(f"{name!r}: its code decodes to no surface", file, remedy) from error
        decoded = (corners - vehicle.sdf_t_object @ vehicle.sdf_R_object) * vehicle.scale_m
        off_m = float(np.abs(decoded - np.array([[-0.5], [0.5]]) * vehicle.size_m).max())
        if off_m > vehicle.scale_m * 2.0 / (MEASURED_RESOLUTION - 1):
            size = " x ".join(f"{side:.2f}" for side in vehicle.size_m)
            what = f"{name!r}: its decoded shape ends {off_m:.2f} m off its box of size_m {size}"
            raise InputError(what, file, remedy)

    def _corners(self, code: NDArray[np.float32], sdf_R_object: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `decoded_corners` (2, 3), from the user's cache folder if it holds them, else decode and cache."""
        made_of = (self.decoder_hash(), code.tobytes(), sdf_R_object.tobytes())
        file = cache_file("drawn", *made_of, program_digest("sdf", "processor.py", "vehicles"))
        if (content := read_cached(file)) is None:
            content = np.stack(decoded_corners(code, self.decoder(), sdf_R_object)).tobytes()
            cache_result(file, content)
        return np.frombuffer(content, np.float64).reshape(2, 3)

    def codes(self) -> NDArray[np.float32]:
        return np.stack([found.latent_code for found in family_vehicles(self._folder / DEFAULT_VEHICLES.name)])

    @functools.cached_property
    def _parametric(self) -> frozenset[str]:
        return parametric_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def is_parametric(self, name: str) -> bool:
        return self._kind(name)[0] in self._parametric

    def parameters(self, name: str) -> ParameterBox:
        kind, number = self._kind(name)
        box = read_parameters(self._folder / DEFAULT_VEHICLES.name, kind)
        return random_box(kind, box, number) if number else box

    def kinds(self) -> list[str]:
        return self.names()

    @functools.cached_property
    def _decoder(self) -> Decoder:
        from shift3d.sdf.decoder import load_decoder

        return load_decoder(self._folder / "sdf.safetensors")

    def decoder(self) -> Decoder:
        return self._decoder

    def decoder_hash(self) -> str:
        path = self._folder / "sdf.safetensors"
        if not path.is_file():
            remedy = "Give a folder that shift3d fit or shift3d train model=sdf wrote"
            raise InputError("no such file", where=str(path), remedy=remedy)
        return hashlib.blake2b(path.read_bytes(), digest_size=16).hexdigest()


def known(name: str, found: Mapping[str, _T], folder: Path) -> _T:
    """Return the entry of a name. Raises: InputError for an unknown name, listing some names of `folder`."""
    if name not in found:
        first = ", ".join(list(found)[:12])
        more = f", ... ({len(found)} in all)" if len(found) > 12 else ""
        raise InputError(f"unknown vehicle {name!r}", where=str(folder), remedy=f"Choose from {first}{more}")
    return found[name]
