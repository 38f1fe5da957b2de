"""The typed schema of a task's settings and of how a sweep runs. Unknown fields are errors, never ignored."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from shift3d.detectors.names import FOREIGN, ONNX, OWN, DetectorName
from shift3d.effects.applicability import NEEDS
from shift3d.settings.names import Text
from shift3d.settings.schema.attack import AttackConfig
from shift3d.settings.schema.records import Count, NotNegative, Number, Positive, Record, Seed, Share
from shift3d.settings.schema.scenes import SceneConfig


class VehicleSetConfig(Record):
    """One vehicle of a folder with vehicles.safetensors and sdf.safetensors; folder null: those that ship."""

    kind: Literal["set"]
    name: Text
    folder: Text | None


class DeepSdfVehicleConfig(Record):
    """One instance of an experiment in the layout of the original DeepSDF repository."""

    kind: Literal["deepsdf"]
    name: Text
    folder: Text
    checkpoint: Text
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    length_m: Positive | dict[Text, Positive]
    code_norm: Positive | None


VehicleConfig = VehicleSetConfig | DeepSdfVehicleConfig


# Settings that belong to some detectors alone.
_SETTINGS_OF: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("config", "vehicle_class", "sensor_height_m", "intensity"), FOREIGN),
    **{"module": (OWN,), "file": (ONNX,), "original": (ONNX,)},
}


class DetectorConfig(Record):
    """The detector under attack, and those that score what was found.

    weights: a file of the attacked detector's. other_weights: files of the others by name; None: what ships.
    scored_by: names; None: every detector whose weights are there. The attacked one scores
    always, and first. module: the Python file of the user's own detector, named "own". file: the ONNX file of the
    detector named "onnx"; original: the detector that it was made from, whose scores it must have. config: of another
    codebase's detector; vehicle_class, sensor_height_m, intensity: beside it, see `detectors.foreign.parts.Choices`.
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
        """The detectors that are asked for by name, the attacked one first, an ONNX file's original last."""
        return (self.name, *(self.scored_by or ()), *([self.original] if self.original else []))

    def weights_by_name(self) -> dict[str, str | None]:
        """Files that were given, by the detector's name: of weights, None: those that ship; an ONNX file."""
        others: dict[str, str | None] = {str(name): path for name, path in self.other_weights.items()}
        return {**others, self.name: self.own_weights, **({ONNX: self.file} if self.file else {})}

    @property
    def own_weights(self) -> str | None:
        """The file of the attacked detector's weights; where several are attacked, `other_weights` names each one's."""
        return self.weights or self.other_weights.get(self.name)

    def modules_by_name(self) -> dict[str, str]:
        """Python files of detectors, by name: of the user's own, where it is asked."""
        return {} if self.module is None else {OWN: self.module}


class _ReferenceConfig(Record):
    def source(self) -> dict[str, Any] | None:
        """Plain values for `naturalness.sources.reference_source`; None where nothing is measured."""
        return self.model_dump(mode="json")


class WideReferenceConfig(_ReferenceConfig):
    """The wide family, both sides of the split. members: how many of it, 21 at least."""

    kind: Literal["wide"]
    members: Annotated[int, Field(ge=21, le=100_000)]


class MeshReferenceConfig(_ReferenceConfig):
    """Every mesh below a folder. forward, up: axes of the files. unit, or length_m, from nose to tail: one of them."""

    kind: Literal["meshes"]
    folder: Text
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    unit: Literal["m", "cm", "mm", "in"] | None
    length_m: Positive | None


class SetReferenceConfig(_ReferenceConfig):
    """Every code of a folder with vehicles.safetensors and sdf.safetensors; folder null: those that ship."""

    kind: Literal["set"]
    folder: Text | None


class NoReferenceConfig(_ReferenceConfig):
    """Naturalness is not measured."""

    kind: Literal["none"]

    def source(self) -> None:
        """Nothing."""


NaturalnessConfig = WideReferenceConfig | MeshReferenceConfig | SetReferenceConfig | NoReferenceConfig


class AccuracyConfig(Record):
    """A preset, and the settings that differ from it (None: as the preset has it).

    detector: precision of the detector inside the search; what is found is scored in float32 or better.
    """

    name: Literal["draft", "standard", "paper", "reference"]
    detector: Literal["bfloat16", "float32", "float64"] | None = None
    render: dict[str, bool | int | float | str | None]


if TYPE_CHECKING:
    EffectName = str
else:
    EffectName = Literal["auto", *NEEDS]


class EffectsConfig(Record):
    """Effects beyond the paper's sensor model, and what is said about scenes beyond what they state themselves.

    use: effects that are forced, by name; "auto": those that a scene calls for. Nothing: the paper's model.
    The others: see `scenes.facts.EffectSettings`; weather is laid over the whole scene.
    """

    use: dict[EffectName, bool]
    visibility_m: Positive | None
    rain_mm_h: NotNegative | None
    snow_mm_h: NotNegative | None
    range_noise_m: Annotated[float, Field(gt=0, le=10.0)] | None
    divergence_rad: Annotated[float, Field(gt=0, le=0.1)] | None
    limit_range_m: Annotated[float, Field(gt=0, le=1e5)] | None
    power_spread: Annotated[float, Field(ge=0, le=10.0)] | None
    object_speed_m_s: Annotated[float, Field(ge=-100.0, le=100.0)] | None

    def forced(self) -> tuple[str, ...]:
        """Names of effects that are used whether a scene calls for them or not."""
        return tuple(name for name, on in self.use.items() if on and name != "auto")

    @property
    def auto(self) -> bool:
        """Whether scenes are asked what they call for."""
        return bool(self.use.get("auto"))

    @property
    def label(self) -> str:
        """In a word: "auto", "none", or names joined by +."""
        return "+".join([*(["auto"] if self.auto else []), *self.forced()]) or "none"

    def overrides(self) -> dict[str, float]:
        """What is said about scenes, by name."""
        values = self.model_dump(exclude={"use"})
        return {name: float(value) for name, value in values.items() if value is not None}


class RayRunnerConfig(Record):
    """Ray workers."""

    kind: Literal["ray"]
    workers: Count | None
    address: Text | None
    cpus_per_worker: Positive
    worker_memory_mb: Positive | None
    task_timeout_s: Positive | None
    batch_seconds: Positive
    commit_seconds: NotNegative
    abort_after: Count | None
    abort_share: Share | None

    def workers_on(self, cpus: int) -> int:
        """Workers of a private Ray on a machine with so many CPUs; at least one."""
        return self.workers or max(1, int(cpus // self.cpus_per_worker))


class LocalRunnerConfig(Record):
    """This process, one task after the other."""

    kind: Literal["local"]
    commit_seconds: NotNegative
    abort_after: Count | None
    abort_share: Share | None


RunnerConfig = RayRunnerConfig | LocalRunnerConfig


class MlflowConfig(Record):
    """An MLflow store."""

    kind: Literal["mlflow"]
    uri: Text
    experiment: Text


class NoTrackingConfig(Record):
    """No tracking."""

    kind: Literal["none"]


class Config(Record):
    """Everything one task is made from, and how its sweep runs.

    ``runner`` and ``tracking`` cannot change a result; all else can. size: which of a sweep's sizes these settings
    come from; by itself it changes nothing.
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
    replicate: Number

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
        """How far a search may move a vehicle from its place, in x and y."""
        return 0.0 if self.mode == "shape" else self.attack.max_shift_m

    def settings(self) -> dict[str, Any]:
        """The settings that can change a result, as plain values."""
        return self.model_dump(mode="json", by_alias=True, exclude={"runner", "tracking"})
