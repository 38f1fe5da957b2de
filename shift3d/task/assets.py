"""What a worker holds in memory and every task reads: scenes, vehicles, decoder and detector."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch

from shift3d.config.catalogue import scene_set, weights_file
from shift3d.config.schema import KittiConfig, StreetConfig
from shift3d.detectors.base import Detector
from shift3d.detectors.weights import load_detector
from shift3d.errors import InputError
from shift3d.render.beams import Beams
from shift3d.render.settings import RenderSettings
from shift3d.scenes.scene import Scene
from shift3d.scenes.sets import SceneSet
from shift3d.sdf.decoder import Decoder, load_decoder
from shift3d.task.spec import AssetsSpec, TaskSpec
from shift3d.vehicles.vehicle import Vehicle, baseline_vehicles

_DTYPES = {"float32": torch.float32, "float64": torch.float64}
# Tasks come grouped by vehicle, so that the same scenes come round again; a scene with its beams is 15 MB.
_SCENES_KEPT = 16


@dataclass
class Assets:
    """Loaded once a worker; never changed by a task.

    scenes: the set that names are looked up in. decoder, detector: float32, as shipped. vehicles: by name.
    Precision twins and scenes with their beams are made on first use and kept.
    """

    scenes: SceneSet
    decoder: Decoder
    detector_name: str
    detector_weights: str | None
    vehicles: Mapping[str, Vehicle]
    _scenes: OrderedDict[str, tuple[Scene, Beams]] = field(default_factory=OrderedDict)
    _decoders: dict[torch.dtype, Decoder] = field(default_factory=dict)
    _detectors: dict[str, Detector] = field(default_factory=dict)

    def scene(self, name: str) -> tuple[Scene, Beams]:
        """A scene and its beams. Raises InputError for an unknown name or a bad frame."""
        if name not in self._scenes:
            scene = self.scenes.load(name)
            self._scenes[name] = (scene, Beams.from_scene(scene))
            if len(self._scenes) > _SCENES_KEPT:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(name)
        return self._scenes[name]

    def decoder_of(self, dtype: torch.dtype) -> Decoder:
        """The decoder with its parameters in a dtype."""
        if dtype not in self._decoders:
            import copy

            same = dtype == torch.float32
            self._decoders[dtype] = self.decoder if same else copy.deepcopy(self.decoder).to(dtype)
        return self._decoders[dtype]

    def detector_of(self, precision: str) -> Detector:
        """The detector with its arithmetic in a precision: bfloat16, float32 or float64."""
        if precision not in self._detectors:
            self._detectors[precision] = load_detector(self.detector_name, self.detector_weights, precision)  # type: ignore[arg-type]
        return self._detectors[precision]

    def vehicle(self, name: str) -> Vehicle:
        """A vehicle by name. Raises InputError for an unknown one."""
        if name not in self.vehicles:
            raise InputError(f"unknown vehicle {name!r}", "task", f"Choose from {', '.join(sorted(self.vehicles))}")
        return self.vehicles[name]


def load_assets(spec: AssetsSpec) -> Assets:
    """Load everything that tasks of a sweep share.

    Raises:
        InputError: naming the file that is missing or unusable.
    """
    weights_file(f"{spec.detector}.safetensors", spec.detector_weights)
    assets = Assets(
        scenes=scene_set(_scene_config(spec.scenes)),
        decoder=load_decoder(spec.decoder_weights),
        detector_name=spec.detector,
        detector_weights=spec.detector_weights,
        vehicles=baseline_vehicles(),
    )
    # Now, not at the first task: weights that do not fit stop the sweep in one line instead of failing every task.
    assets.detector_of("float32")
    return assets


def _scene_config(values: Mapping[str, Any]) -> StreetConfig | KittiConfig:
    kinds: dict[str, type[StreetConfig] | type[KittiConfig]] = {"street": StreetConfig, "kitti": KittiConfig}
    return kinds[values["kind"]](**values)


def render_settings(spec: TaskSpec) -> RenderSettings:
    """The renderer's settings that a task states in plain values."""
    values = {name: value for name, value in spec.accuracy_settings.items() if name != "detector"}
    if values.get("dtype") not in _DTYPES:
        raise InputError(
            f"accuracy.render.dtype is {values.get('dtype')!r}", f"task {spec.task_id}", "float32 or float64"
        )
    values["dtype"] = _DTYPES[values["dtype"]]
    return RenderSettings(**values)


def search_precision(spec: TaskSpec) -> str:
    """Precision of the detector while it is descended."""
    return str(spec.accuracy_settings.get("detector", "float32"))


def score_precision(spec: TaskSpec) -> str:
    """Precision of the detector that scores: float32, or float64 where the search has it too."""
    return "float64" if search_precision(spec) == "float64" else "float32"
