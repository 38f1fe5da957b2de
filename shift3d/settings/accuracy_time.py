"""Settings of `shift3d frontier`: the section ``frontier`` of sweeps/accuracy_time.yaml, typed and expanded."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from shift3d.detectors.names import ONNX
from shift3d.errors import InputError
from shift3d.settings import messages
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.compose import Values
from shift3d.settings.schema.config import AccuracyConfig, Config
from shift3d.settings.schema.records import Count, NonNegativeFloat, NonNegativeInt, Positive, Record

_CROP = "crop_m"


class FrontierSettingConfig(Record):
    """One measured setting, or one line of the diagram if ``over`` lists values.

    name: unique name; with ``over``, the value replaces "{}". method: line of the diagram. preset: base preset; a
    setting named like its preset is the shipped preset. render: overrides of ``accuracy.render``. over: one setting of
    ``accuracy.render``, or crop_m, and its values. detector: precision of the detector in the search; null: the
    preset's. crop_m: radius around the vehicle within which the detector computes proposals; null: the whole scene.
    warm: start from the previous rendering of an attack on the shape or the pose, timed with everything that this
    attack's gradient needs. gradient: time a cold rendering with everything that the gradient of the shape or the pose
    needs. grid: use an SDF grid of the shape, as tasks do. incremental: let a warm detector reuse its results for the
    previous rendering. displaced: also render the adversarially displaced shape. steps: attack steps timed per case.
    attack_steps: length of two attacks, on the shape and on the pose, whose scores go to the table; 0: no attacks.
    bfloat16: skip the setting on processors without bfloat16 instructions.
    """

    name: str
    method: str
    preset: Literal["draft", "standard", "paper", "reference"]
    render: dict[str, bool | int | float | str] = Field(default={})
    over: dict[str, Annotated[list[NonNegativeFloat], Field(min_length=1)]] = Field(default={}, max_length=1)
    detector: Literal["bfloat16", "float32", "float64"] | None = None
    crop_m: Positive | None = 8.0
    warm: Literal["no", "shape", "pose"] = "no"
    gradient: Literal["no", "shape", "pose"] = "no"
    grid: bool = False
    incremental: bool = True
    displaced: bool = True
    steps: Count = 1
    attack_steps: NonNegativeInt = 0
    bfloat16: bool = False


class FrontierCaseConfig(Record):
    """One vehicle at one distance, in the first scene with room for the vehicle at this distance."""

    vehicle: str
    range_m: Positive


class FrontierConfig(Record):
    """Measured settings, cases, and numbers of repeats.

    within_m: tolerance of a vehicle's distance. min_object_points: minimum number of returns on a vehicle.
    descent_steps: steps of the attack that displaces the shape. warm_steps: consecutive renderings before a warm
    rendering is measured. repeats: most timings of a setting on a case. seconds: time limit of these timings. slow_s: a
    slower rendering is timed once, together with its errors. kitti: folder that holds training/, a second scene set.
    quick: names of the settings of ``--quick``. quick_cases: number of its cases, the farthest first.
    """

    settings: Annotated[list[FrontierSettingConfig], Field(min_length=1)]
    cases: Annotated[list[FrontierCaseConfig], Field(min_length=1)]
    within_m: Positive
    min_object_points: Count
    descent_steps: NonNegativeInt
    warm_steps: Count
    repeats: Count
    seconds: Positive
    slow_s: Positive
    kitti: str | None
    quick: list[str]
    quick_cases: Count


class FrontierSweepConfig(Config):
    """Settings of a sweep plus the section ``frontier``."""

    frontier: FrontierConfig

    @model_validator(mode="after")
    def _one_detector_with_a_gradient(self) -> Self:
        if self.detector.name == ONNX:
            raise ValueError("the frontier measures gradients, and an ONNX file gives none: give another detector=NAME")
        for name, file in self.detector.other_weights.items():
            if file and name != self.detector.name:
                what = f"detector.other_weights.{name} means nothing: the frontier measures {self.detector.name} alone"
                raise ValueError(what, f"Leave it out, or give detector={name}")
        return self


def validate_frontier(values: Values, where: str) -> FrontierSweepConfig:
    """Check composed settings. Raises: InputError naming the wrong field and its valid values."""
    try:
        return FrontierSweepConfig.model_validate(values)
    except ValidationError as error:
        raise messages.from_validation(error, where) from error


def expand_settings(config: FrontierConfig) -> list[tuple[FrontierSettingConfig, AccuracyConfig]]:
    """Expand ``over`` to single settings; return each with its accuracy, in the file's order.

    Raises: InputError: a duplicate name, an invalid override of the renderer, a name without "{}", or an unknown name
    in ``quick``.
    """
    where, found = "frontier.settings", []
    for setting in config.settings:
        found += _written_out(setting, where)
    names = [setting.name for setting in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two settings are called {name!r}", where=where, remedy="Give each its own name")
    for name in config.quick:
        if name not in names:
            raise messages.choice_error("setting", name, names, "frontier.quick")
    pairs = []
    for setting in found:
        accuracy = AccuracyConfig(name=setting.preset, detector=setting.detector, render=dict(setting.render))
        accuracy_settings(accuracy)
        pairs.append((setting, accuracy))
    return pairs


def _written_out(setting: FrontierSettingConfig, where: str) -> list[FrontierSettingConfig]:
    from shift3d.render.settings import STANDARD

    if not setting.over:
        changed = setting.render or setting.detector or (setting.warm, setting.gradient) != ("no", "no")
        if setting.name == setting.preset and changed:
            what = f"{setting.name!r} is a preset's name, with other settings than the preset's"
            raise InputError(what, where=where, remedy="Give it another name")
        return [setting]
    ((knob, values),) = setting.over.items()
    if "{}" not in setting.name:
        remedy = 'Put "{}" where the value goes'
        raise InputError(f"{setting.name!r} has no place for {knob}", where=where, remedy=remedy)
    written = []
    for value in values:
        if knob == _CROP and not value > 0:
            what = f"crop_m is {value:g} in {setting.name!r}"
            raise InputError(
                what, where, "Give radii above 0, or a setting of its own with crop_m: null, the whole scene"
            )
        changes = {"name": setting.name.replace("{}", f"{value:g}"), "over": {knob: [value]}}
        whole = value == int(value) and isinstance(getattr(STANDARD, knob, None), int)
        plain = int(value) if whole else value
        more = {_CROP: value} if knob == _CROP else {"render": {**setting.render, knob: plain}}
        written.append(setting.model_copy(update={**changes, **more}))
    return written
