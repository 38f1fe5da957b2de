"""The typed schema of a task's settings and of how a sweep runs. Unknown fields are errors, never ignored."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

__all__ = [
    "AccuracyConfig",
    "AttackConfig",
    "Config",
    "DeepSdfVehicleConfig",
    "DetectorConfig",
    "EffectsConfig",
    "KittiConfig",
    "LocalRunnerConfig",
    "MlflowConfig",
    "NoTrackingConfig",
    "PlacementConfig",
    "RayRunnerConfig",
    "StreetConfig",
    "VehicleConfig",
    "VehicleSetConfig",
]

Seed = Annotated[int, Field(ge=0, lt=2**63)]
# Beyond these limits lie typing errors: a list of 10**12 scenes, squares of 1e300 that are infinite.
_MOST, _LARGEST = 10**6, 1e9
Count = Annotated[int, Field(ge=1, le=_MOST)]
Number = Annotated[int, Field(ge=0, le=_MOST)]
Positive = Annotated[float, Field(gt=0, le=_LARGEST, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=_LARGEST, allow_inf_nan=False)]


class _Record(BaseModel):
    # strict: "0.5" is no number and true is no 1, since Hydra has read the types already. A float may be written 1.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class StreetConfig(_Record):
    """Procedural street scenes."""

    kind: Literal["street"]
    sensor: Literal["hdl64", "waymo_top", "mixed"]
    split: Literal["train", "val", "test"]
    seed: Seed
    count: Count


class KittiConfig(_Record):
    """KITTI object frames under ``root``/training."""

    kind: Literal["kitti"]
    root: str
    count: Count | None
    names: list[str] | None


class VehicleSetConfig(_Record):
    """One vehicle of a folder with vehicles.safetensors and sdf.safetensors; folder null: those that ship."""

    kind: Literal["set"]
    name: str
    folder: str | None


class DeepSdfVehicleConfig(_Record):
    """One instance of an experiment in the layout of the original DeepSDF repository."""

    kind: Literal["deepsdf"]
    name: str
    folder: str
    checkpoint: str
    forward: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    up: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    length_m: Positive | dict[str, Positive]
    code_norm: Positive | None


VehicleConfig = VehicleSetConfig | DeepSdfVehicleConfig
DetectorName = Literal["pointpillars", "sst", "sst_small"]


class DetectorConfig(_Record):
    """The detector under attack, and those that score what was found.

    weights: a file of the attacked detector's. other_weights: files of the others by name; None: what ships.
    scored_by: names; None: every detector whose weights are there. The attacked one scores always, and first.
    """

    name: DetectorName
    weights: str | None
    scored_by: list[DetectorName] | None
    other_weights: dict[DetectorName, str | None]

    def weights_by_name(self) -> dict[str, str | None]:
        """Files of weights that were given, by the detector's name; None: those that ship."""
        return {**{str(name): path for name, path in self.other_weights.items()}, self.name: self.weights}


class PlacementConfig(_Record):
    """Where a vehicle may be put; metres."""

    min_range_m: NotNegative
    max_range_m: Positive
    min_object_points: Number
    overlap_m: NotNegative
    contact_m: Positive
    attempts: Count

    @model_validator(mode="after")
    def _a_ring(self) -> Self:
        if self.min_range_m >= self.max_range_m:
            raise ValueError(f"min_range_m {self.min_range_m:g} is not below max_range_m {self.max_range_m:g}")
        return self


class AttackConfig(_Record):
    """The search and its comparisons."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, populate_by_name=True)

    steps: Number
    alpha: Positive
    lambda_: Annotated[float, Field(alias="lambda", ge=0, le=_LARGEST, allow_inf_nan=False)]
    random_replicates: Number
    noise_replicates: Number
    noise_sigma: NotNegative
    max_shift_m: NotNegative
    max_tilt_rad: NotNegative
    sphere_m: Positive
    detection_radius_m: Positive
    placement: PlacementConfig


class AccuracyConfig(_Record):
    """A preset, and the settings that differ from it (None: as the preset has it).

    detector: precision of the detector inside the search; what is found is scored in float32 or better.
    """

    name: Literal["draft", "standard", "paper", "reference"]
    detector: Literal["bfloat16", "float32", "float64"] | None = None
    render: dict[str, bool | int | float | str | None]


class EffectsConfig(_Record):
    """Effects beyond the paper's sensor model, in physical order."""

    names: list[str]


class RayRunnerConfig(_Record):
    """Ray workers."""

    kind: Literal["ray"]
    workers: Count | None
    address: str | None
    cpus_per_worker: Positive
    batch_seconds: Positive
    commit_seconds: NotNegative


class LocalRunnerConfig(_Record):
    """This process, one task after the other."""

    kind: Literal["local"]
    commit_seconds: NotNegative


class MlflowConfig(_Record):
    """An MLflow store."""

    kind: Literal["mlflow"]
    uri: str
    experiment: str


class NoTrackingConfig(_Record):
    """No tracking."""

    kind: Literal["none"]


class Config(_Record):
    """Everything one task is made from, and how its sweep runs.

    ``runner`` and ``tracking`` cannot change a result; all else can.
    """

    scenes: Annotated[StreetConfig | KittiConfig, Field(discriminator="kind")]
    vehicle: Annotated[VehicleConfig, Field(discriminator="kind")]
    detector: DetectorConfig
    attack: AttackConfig
    accuracy: AccuracyConfig
    effects: EffectsConfig
    runner: Annotated[RayRunnerConfig | LocalRunnerConfig, Field(discriminator="kind")]
    tracking: Annotated[MlflowConfig | NoTrackingConfig, Field(discriminator="kind")]
    mode: Literal["shape", "pose"]
    scene: str | None
    seed: Seed
    replicate: Number

    def settings(self) -> dict[str, Any]:
        """The settings that can change a result, as plain values."""
        return self.model_dump(mode="json", by_alias=True, exclude={"runner", "tracking"})
