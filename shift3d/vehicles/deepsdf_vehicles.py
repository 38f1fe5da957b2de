"""Vehicle source for a DeepSDF experiment: its latent codes, scaled to a length and measured."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.parameter_box import ParameterBox
from shift3d.vehicles.sources import VehicleSource, known
from shift3d.vehicles.vehicle import LARGEST_SCALE_M, Vehicle, centred_vehicle, decoded_corners

# A plan needs names and hashes only, so the decoder modules are imported where a vehicle is decoded.
if TYPE_CHECKING:
    from shift3d.sdf.decoder import Decoder
    from shift3d.sdf.deepsdf_checkpoint import DeepSdfCheckpoint
    from shift3d.sdf.deepsdf_network import DeepSdfNetwork

_SHORTEST_CODE = 1e-6  # trained codes have norms of some tenths; shorter codes are untrained


class DeepSdfVehicles(VehicleSource):
    """Instances of a DeepSDF experiment as vehicles, each scaled to a length and measured as decoded.

    Args:
        folder: in the original layout. checkpoint: "latest", or an epoch.
        forward, up: axes of the sdf frame. The default is ShapeNet's, as pictures of the decoded surfaces show.
        length_m: from nose to tail: one value for all vehicles, or values by name prefix (the longest match wins),
            with "default" for the others. Normalised meshes have no metric size.
        code_norm: mean norm to which the experiment's codes are scaled; the decoder's code columns are scaled
            inversely. None keeps the trained scale. Shapes do not depend on it, but the attack does: alpha and lambda
            are in code units, and the paper does not state the norm of its codes. conf/ has 1.5, our choice. The codes
            of the 57 real cars have norm 0.59 as trained, and a unit of code then moves their surface by 0.9 m (root
            mean square), against 0.35 m for the shipped vehicles: five steps led to twice the code's norm off the car.
            At 1.5 a unit moves both kinds of surface alike; that, not the attack's results, decided the choice.
    Raises: InputError for an invalid axis or length.
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
        lengths = {"default": length_m} if isinstance(length_m, float | int) else length_m
        self._frames = {
            "" if key == "default" else key: MeshFrame(forward, up, length_m=float(length))
            for key, length in lengths.items()
        }
        self._measured: dict[str, Vehicle] = {}

    @functools.cached_property
    def _experiment(self) -> DeepSdfCheckpoint:
        from shift3d.sdf.deepsdf_checkpoint import load_deepsdf_checkpoint

        return load_deepsdf_checkpoint(self._folder, self._checkpoint)

    @functools.cached_property
    def _code_scale(self) -> float:
        """Factor from trained codes to codes in use."""
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
        return (self._experiment.codes * self._code_scale).numpy()

    def is_parametric(self, name: str) -> bool:
        return False

    def kinds(self) -> list[str]:
        what = "each vehicle of a DeepSDF checkpoint has to be decoded before a search can turn to it"
        raise InputError(what, f"{self._folder}, attack.space=family", "Give attack.space=pca or free")

    def parameters(self, name: str) -> ParameterBox:
        what, remedy = "the codes of a DeepSDF checkpoint are made of no parameters", "Give attack.space=pca or free"
        raise InputError(what, f"{self._folder}, attack.space=parameters", remedy)

    def decoder(self) -> Decoder | DeepSdfNetwork:
        """Return the decoder, see `VehicleSource`; the same object every time."""
        return self._scaled

    def decoder_hash(self) -> str:
        from shift3d.sdf.deepsdf_checkpoint import experiment_files

        digest = hashlib.blake2b(repr(self._code_norm).encode(), digest_size=16)
        for path in experiment_files(self._folder, self._checkpoint):
            digest.update(hashlib.blake2b(path.read_bytes(), digest_size=16).digest())
        return digest.hexdigest()

    def vehicle(self, name: str) -> Vehicle:
        """Return a vehicle, see `VehicleSource`. The first call for a name decodes its surface: some seconds.

        The origin of the object frame is the centre of the decoded box, and size_m the box's size, to the millimetre.
        """
        if name not in self._measured:
            index = known(name, {name: i for i, name in enumerate(self.names())}, self._folder)
            self._measured[name] = self._measure(name, (self._experiment.codes[index] * self._code_scale).numpy())
        return self._measured[name]

    def _measure(self, name: str, code: NDArray[np.float32]) -> Vehicle:
        frame = self._frame_of(name)
        assert frame.length_m is not None
        sdf_R_object = frame.object_R_file().T
        low, high = decoded_corners(code, self._scaled, sdf_R_object)
        frame.check_direction(high - low, f"{self._folder}, {name}", "vehicle.")
        scale_m = round(float(frame.length_m / (high - low)[0]), 4)
        if scale_m > LARGEST_SCALE_M:
            what = f"its shape is {(high - low)[0]:.2g} long in the unit sphere: scale_m {scale_m:g} is above"
            remedy = "Give a shorter vehicle.length_m, or a checkpoint whose shapes fill the sphere"
            raise InputError(f"{what} {LARGEST_SCALE_M:g}", f"{self._folder}, {name}", remedy)
        return centred_vehicle(name, code, scale_m, sdf_R_object, low, high)

    def _frame_of(self, name: str) -> MeshFrame:
        fitting = [key for key in self._frames if name.startswith(key)]
        if not fitting:
            what = f"vehicle.length_m says nothing about {name}"
            raise InputError(what, where=str(self._folder), remedy="Add default=4.5 to it")
        return self._frames[max(fitting, key=len)]
