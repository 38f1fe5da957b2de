"""Where a sweep's vehicles come from; a set of vehicle files is one such source."""

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
from shift3d.store.user_cache import keep, kept_file, program_digest, read_kept
from shift3d.vehicles.parameter_box import (
    BoxOfParameters,
    drawn_box,
    drawn_code,
    kind_and_number,
    parametric_vehicles,
    read_parameters,
)
from shift3d.vehicles.vehicle import (
    DEFAULT_VEHICLES,
    Vehicle,
    baseline_vehicles,
    decoded_corners,
    family_vehicles,
    framed,
)

# A plan asks for names and hashes: what draws vehicles is imported where one is drawn.
if TYPE_CHECKING:
    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

_T = TypeVar("_T")
WIDE = "wide"
"""The set of the parametric decoder, in `weights/wide`; a user's folder of that name is ./wide."""


class VehicleSource(Protocol):
    """Vehicles by name, and the decoder that draws them."""

    def names(self) -> list[str]:
        """Every vehicle's name, in a fixed order; of those drawn from a kind's ranges the kind alone."""
        ...

    def vehicle(self, name: str) -> Vehicle:
        """One of them, or one drawn from a kind that is made of parameters. Raises InputError for an unknown name."""
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

    None: the five vehicles that ship. "wide": those that ship with a parametric decoder. Where a vehicle NAME is made
    of parameters, there are NAME-1, NAME-2, ... too, drawn at random from its ranges; the first call for one takes two
    seconds, once a machine.
    """

    def __init__(self, folder: Path | str | None = None) -> None:
        self._folder = set_folder(folder)
        self._drawn: dict[str, Vehicle] = {}

    @functools.cached_property
    def _vehicles(self) -> dict[str, Vehicle]:
        return baseline_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def names(self) -> list[str]:
        return list(self._vehicles)

    def _kind(self, name: str) -> tuple[str, int]:
        """See `kind_and_number`; a vehicle of the folder may itself be called so."""
        kind, number = kind_and_number(name)
        return (kind, number) if name not in self._vehicles and kind in self._parametric else (name, 0)

    def vehicle(self, name: str) -> Vehicle:
        kind, number = self._kind(name)
        found = known(kind, self._vehicles, self._folder)
        if number and name not in self._drawn:
            code = drawn_code(found.latent_code, self.parameters(kind), self.parameters(name))
            corners = self._corners(code, found.sdf_R_object)
            self._drawn[name] = framed(name, code, found.scale_m, found.sdf_R_object, *corners)
        return self._drawn[name] if number else found

    def _corners(self, code: NDArray[np.float32], sdf_R_object: NDArray[np.float64]) -> NDArray[np.float64]:
        """`decoded_corners` (2, 3), from the user's cache folder; decoded, and kept there, where it holds none."""
        made_of = (self.decoder_hash(), code.tobytes(), sdf_R_object.tobytes())
        file = kept_file("drawn", *made_of, program_digest("sdf", "processor.py", "vehicles"))
        if (content := read_kept(file)) is None:
            content = np.stack(decoded_corners(code, self.decoder(), sdf_R_object)).tobytes()
            keep(file, content)
        return np.frombuffer(content, np.float64).reshape(2, 3)

    def codes(self) -> NDArray[np.float32]:
        return np.stack([found.latent_code for found in family_vehicles(self._folder / DEFAULT_VEHICLES.name)])

    @functools.cached_property
    def _parametric(self) -> frozenset[str]:
        return parametric_vehicles(self._folder / DEFAULT_VEHICLES.name)

    def is_parametric(self, name: str) -> bool:
        return self._kind(name)[0] in self._parametric

    def parameters(self, name: str) -> BoxOfParameters:
        kind, number = self._kind(name)
        box = read_parameters(self._folder / DEFAULT_VEHICLES.name, kind)
        return drawn_box(kind, box, number) if number else box

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
    """What has a name. Raises InputError for an unknown one, listing some. folder: whose names they are."""
    if name not in found:
        first = ", ".join(list(found)[:12])
        more = f", ... ({len(found)} in all)" if len(found) > 12 else ""
        raise InputError(f"unknown vehicle {name!r}", where=str(folder), remedy=f"Choose from {first}{more}")
    return found[name]
