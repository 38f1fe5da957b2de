"""Typed schema of a task's settings and of a sweep's execution. Unknown fields are errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from shift3d.detectors.names import FOREIGN, ONNX, OWN, DetectorName
from shift3d.effects.applicability import NEEDS
from shift3d.settings.names import Text
from shift3d.settings.schema.attack import AttackConfig
from shift3d.settings.schema.records import Count, NonNegativeFloat, NonNegativeInt, Positive, Record, Seed, Share
from shift3d.settings.schema.scenes import SceneConfig


class VehicleSetConfig(Record):
    """One vehicle of a folder with vehicles.safetensors and sdf.safetensors. folder null: the shipped files."""

    kind: Literal["set"]
    name: Text
    folder: Text | None


class DeepSdfVehicleConfig(Record):
    """One vehicle of an experiment in the layout of the original DeepSDF repository."""

    kind: Literal["deepsdf"]
    name: Text
    folder: Text
    checkpoint: Text
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    length_m: Positive | dict[Text, Positive]
    code_norm: Positive | None


VehicleConfig = VehicleSetConfig | DeepSdfVehicleConfig


# Settings that apply to the listed detectors only.
_SETTINGS_OF: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("config", "vehicle_class", "sensor_height_m", "intensity"), FOREIGN),
    **{"module": (OWN,), "file": (ONNX,), "original": (ONNX,)},
}


class DetectorConfig(Record):
    """Detector under attack, and the detectors that score the solutions.

    weights: file of weights of the attacked detector. other_weights: files of the other detectors by name. None: the
    shipped weights. scored_by: names of scoring detectors; None: every detector with weights. The attacked detector
    always scores, as the first. module: Python file of the user's detector "own". file: file of the detector "onnx".
    original: detector that the ONNX file was exported from, whose scores it must match. config: config file of another
    codebase's detector. vehicle_class, sensor_height_m, intensity: see `detectors.foreign.config_common`.
    """

    name: DetectorName
    weights: Text | None = None
    scored_by: list[DetectorName] | None
    other_weights: dict[DetectorName, Text | None]
    module: Text | None = None
    file: Text | None = None
    original: DetectorName | None = None
    config: Text | None = None
    vehicle_class: Text | None = None
    sensor_height_m: Annotated[float, Field(ge=-10.0, le=10.0)] | None = None
    intensity: Annotated[float, Field(ge=-1e6, le=1e6)] | None = None

    @model_validator(mode="after")
    def _what_the_named_are_made_of(self) -> Self:
        if self.original == ONNX:
            raise ValueError("original is onnx: name the detector that the file was made from")
        if self.name == ONNX and self.weights is not None:
            raise ValueError("weights means nothing for detector=onnx: give detector.file=FILE.onnx")
        for key, of in _SETTINGS_OF.items():
            if getattr(self, key) is not None and not set(of) & set(self.named()):
                raise ValueError(f"{key} means nothing without {' or '.join(f'detector={name}' for name in of)}")
        foreign = [name for name in FOREIGN if name in self.named()]
        if len(foreign) > 1:
            raise ValueError("config is of one of openpcdet and mmdet3d: name one of them")
        for key, file in (("module", "FILE.py"), ("config", "FILE"), ("file", "FILE.onnx")):
            named = [name for name in _SETTINGS_OF[key] if name in self.named()]
            if named and getattr(self, key) is None:
                raise ValueError(f"{key} is null, and the detector {named[0]} is made of it: detector.{key}={file}")
        if foreign and self.weights_by_name().get(foreign[0]) is None:
            raise ValueError(f"{foreign[0]} needs its weights: detector.weights=FILE, or other_weights.{foreign[0]}")
        return self

    def named(self) -> tuple[str, ...]:
        """Return the detectors that the settings name, the attacked detector first, an ONNX file's original last."""
        return (self.name, *(self.scored_by or ()), *([self.original] if self.original else []))

    def weights_by_name(self) -> dict[str, str | None]:
        """Return the given files of weights (None: shipped) and the ONNX file, by detector name."""
        others: dict[str, str | None] = {str(name): path for name, path in self.other_weights.items()}
        return {**others, self.name: self.own_weights, **({ONNX: self.file} if self.file else {})}

    @property
    def own_weights(self) -> str | None:
        """File of the attacked detector's weights. A sweep over several detectors gives the files in other_weights."""
        return self.weights or self.other_weights.get(self.name)

    def modules_by_name(self) -> dict[str, str]:
        """Return the Python file of the user's detector by the detector's name; {} without one."""
        return {} if self.module is None else {OWN: self.module}


class _ReferenceConfig(Record):
    def source(self) -> dict[str, Any] | None:
        """Return plain values for `naturalness.sources.reference_source`; None if naturalness is not measured."""
        return self.model_dump(mode="json")


class WideReferenceConfig(_ReferenceConfig):
    """Reference set of the wide family, seen and held-out kinds. members: number of vehicles, at least 21."""

    kind: Literal["wide"]
    members: Annotated[int, Field(ge=21, le=100_000)]


class MeshReferenceConfig(_ReferenceConfig):
    """Reference set of all meshes in a folder. forward, up: axes of the files. Give unit, or length_m, nose to tail."""

    kind: Literal["meshes"]
    folder: Text
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    unit: Literal["m", "cm", "mm", "in"] | None
    length_m: Positive | None


class SetReferenceConfig(_ReferenceConfig):
    """Reference set of all codes of a folder with vehicles.safetensors and sdf.safetensors. folder null: shipped."""

    kind: Literal["set"]
    folder: Text | None


class NoReferenceConfig(_ReferenceConfig):
    """No reference set: naturalness is not measured."""

    kind: Literal["none"]

    def source(self) -> None:
        """Return None."""


NaturalnessConfig = WideReferenceConfig | MeshReferenceConfig | SetReferenceConfig | NoReferenceConfig


class AccuracyConfig(Record):
    """Accuracy preset and overrides. None: the preset's value.

    detector: precision of the detector in the search; solutions are scored in float32 or better.
    """

    name: Literal["draft", "standard", "paper", "reference"]
    detector: Literal["bfloat16", "float32", "float64"] | None = None
    render: dict[str, bool | int | float | str | None]


if TYPE_CHECKING:
    EffectName = str
else:
    EffectName = Literal["auto", *NEEDS]


class EffectsConfig(Record):
    """Effects beyond the paper's sensor model, and sensor and weather values that override those of scenes.

    use: forced effects by name; "auto": the effects that a scene calls for; empty: the paper's sensor model.
    Other fields: see `scenes.facts.EffectSettings`. Weather applies to the whole scene.
    """

    use: dict[EffectName, bool]
    visibility_m: Positive | None
    rain_mm_h: NonNegativeFloat | None
    snow_mm_h: NonNegativeFloat | None
    range_noise_m: Annotated[float, Field(gt=0, le=10.0)] | None
    divergence_rad: Annotated[float, Field(gt=0, le=0.1)] | None
    limit_range_m: Annotated[float, Field(gt=0, le=1e5)] | None
    power_spread: Annotated[float, Field(ge=0, le=10.0)] | None
    object_speed_m_s: Annotated[float, Field(ge=-100.0, le=100.0)] | None

    def forced(self) -> tuple[str, ...]:
        """Return the effects that every scene uses, whether it calls for them or not, in physical order."""
        return tuple(name for name in NEEDS if self.use.get(name))

    @property
    def auto(self) -> bool:
        """True if scenes use the effects that they call for."""
        return bool(self.use.get("auto"))

    @property
    def label(self) -> str:
        """Label: "auto", "none", or names joined by +."""
        return "+".join([*(["auto"] if self.auto else []), *self.forced()]) or "none"

    def overrides(self) -> dict[str, float]:
        """Return the values that override those of scenes, by name."""
        values = self.model_dump(exclude={"use"})
        return {name: float(value) for name, value in values.items() if value is not None}


class RayRunnerConfig(Record):
    """Runner of Ray workers."""

    kind: Literal["ray"]
    workers: Count | None
    address: Text | None
    cpus_per_worker: Annotated[Positive, Field(ge=1e-4)]  # the smallest part of a CPU that Ray counts
    worker_memory_mb: Positive | None
    task_timeout_s: Positive | None
    batch_seconds: Positive
    commit_seconds: NonNegativeFloat
    abort_after: Count | None
    abort_share: Share | None

    def workers_on(self, cpus: int) -> int:
        """Return the number of workers of a private Ray on a machine with `cpus` CPUs; at least one."""
        # Ray counts ten-thousandths of a CPU; 2 // 0.1 is 19.
        return self.workers or max(1, round(1e4 * cpus) // round(1e4 * self.cpus_per_worker))


class LocalRunnerConfig(Record):
    """Runner in this process, one task after the other."""

    kind: Literal["local"]
    commit_seconds: NonNegativeFloat
    abort_after: Count | None
    abort_share: Share | None


RunnerConfig = RayRunnerConfig | LocalRunnerConfig


class MlflowConfig(Record):
    """MLflow store for tracking."""

    kind: Literal["mlflow"]
    uri: Text
    experiment: Text


class NoTrackingConfig(Record):
    """No tracking."""

    kind: Literal["none"]


class Config(Record):
    """All settings of one task, and of its sweep's execution.

    ``runner`` and ``tracking`` cannot change a result; all other settings can. size: label of the sweep size that these
    settings come from, without effect by itself.
    """

    scenes: Annotated[SceneConfig, Field(discriminator="kind")]
    vehicle: Annotated[VehicleConfig, Field(discriminator="kind")]
    detector: DetectorConfig
    attack: AttackConfig
    accuracy: AccuracyConfig
    effects: EffectsConfig
    naturalness: Annotated[NaturalnessConfig, Field(discriminator="kind")]
    runner: Annotated[RunnerConfig, Field(discriminator="kind")]
    tracking: Annotated[MlflowConfig | NoTrackingConfig, Field(discriminator="kind")]
    size: Literal["full", "small"] = "full"
    mode: Literal["shape", "pose", "shape_pose"]
    scene: Text | None
    seed: Seed
    replicate: NonNegativeInt

    @model_validator(mode="after")
    def _a_reference_for_the_budget(self) -> Self:
        if self.attack.naturalness and self.naturalness.kind == "none":
            raise ValueError("attack.naturalness is a percentile of a reference set: give naturalness=wide")
        return self

    @model_validator(mode="after")
    def _one_scene_for_a_pose(self) -> Self:
        if self.mode == "shape_pose" and (self.attack.search_scenes or self.attack.transfer_scenes):
            raise ValueError("attack.search_scenes and transfer_scenes are of mode=shape: a pose belongs to its scene")
        return self

    @property
    def shift_m(self) -> float:
        """Largest shift of a vehicle from its place by the search, in x and y."""
        return 0.0 if self.mode == "shape" else self.attack.max_shift_m

    def settings(self) -> dict[str, Any]:
        """Return the settings that can change a result, as plain values."""
        return self.model_dump(mode="json", by_alias=True, exclude={"runner", "tracking"})
