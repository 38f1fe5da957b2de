"""What `shift3d frontier` measures: the section ``frontier`` of sweeps/accuracy_time.yaml, typed and expanded."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from shift3d.detectors.names import ONNX
from shift3d.errors import InputError
from shift3d.settings import messages
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.compose import Values
from shift3d.settings.schema.config import AccuracyConfig, Config
from shift3d.settings.schema.records import Count, Number, Positive, Record

_CROP = "crop_m"


class MeasuredSetting(Record):
    """One setting, or one line of the diagram where ``over`` has values.

    name: unique; with ``over``, "{}" in it is where the value goes. method: the line it belongs to. preset: what it
    starts from; a setting called like its preset is that preset as it ships. render: overrides of
    ``accuracy.render``. over: one of these settings, or crop_m, and its values. detector: precision in the search;
    null: the preset's. crop_m: how far around the vehicle the detector looks at proposals; null: the whole scene.
    warm: start from the previous rendering of an attack on the shape or the pose; it is timed with all that the
    gradient of that attack needs. gradient: a cold one is timed with what the gradient of the shape or the pose needs.
    grid: with an SDF grid of the shape, as tasks have one of each vehicle. incremental: where it is warm, let the
    detector reuse what it computed for the previous rendering. displaced: render the adversarially displaced shape too.
    steps: attack steps that are timed on a case. attack_steps: length of attacks, one on the shape and one on the pose,
    whose scores the table has; 0: none. bfloat16: left out where the processor has no instructions for it.
    """

    name: str
    method: str
    preset: Literal["draft", "standard", "paper", "reference"]
    render: dict[str, bool | int | float | str] = Field(default={})
    over: dict[str, Annotated[list[float], Field(min_length=1)]] = Field(default={}, max_length=1)
    detector: Literal["bfloat16", "float32", "float64"] | None = None
    crop_m: Positive | None = 8.0
    warm: Literal["no", "shape", "pose"] = "no"
    gradient: Literal["no", "shape", "pose"] = "no"
    grid: bool = False
    incremental: bool = True
    displaced: bool = True
    steps: Count = 1
    attack_steps: Number = 0
    bfloat16: bool = False


class MeasuredCase(Record):
    """One vehicle at one distance, in the first scene that has room for it there."""

    vehicle: str
    range_m: Positive


class FrontierConfig(Record):
    """What is measured, on what, and how often.

    within_m: how far from its distance a vehicle may stand. min_object_points: fewest returns on it. descent_steps:
    of the attack that makes the displaced shape. warm_steps: renderings in a row before a warm one is looked at.
    repeats: most timings of a setting on a case. seconds: these timings end after so long. slow_s: what takes longer
    is timed by the one rendering that its errors are taken from. kitti: folder with training/, a second set of
    scenes. quick: settings of ``--quick``, and how many cases, the farthest first.
    """

    settings: Annotated[list[MeasuredSetting], Field(min_length=1)]
    cases: Annotated[list[MeasuredCase], Field(min_length=1)]
    within_m: Positive
    min_object_points: Count
    descent_steps: Number
    warm_steps: Count
    repeats: Count
    seconds: Positive
    slow_s: Positive
    kitti: str | None
    quick: list[str]
    quick_cases: Count


class FrontierSweep(Config):
    """Everything of a sweep, and the section ``frontier``."""

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


def validate_frontier(values: Values, where: str) -> FrontierSweep:
    """Check composed settings. Raises InputError naming the field and what it may be."""
    try:
        return FrontierSweep.model_validate(values)
    except ValidationError as error:
        raise messages.from_validation(error, where) from error


def expand_settings(config: FrontierConfig) -> list[tuple[MeasuredSetting, AccuracyConfig]]:
    """Settings with ``over`` written out, and each one's accuracy, in the file's order.

    Raises: InputError: two settings of one name, an override that the renderer does not have or cannot take, a name
    without a place for its value, or a name in ``quick`` that is none.
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


def _written_out(setting: MeasuredSetting, where: str) -> list[MeasuredSetting]:
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
        changes = {"name": setting.name.replace("{}", f"{value:g}"), "over": {knob: [value]}}
        whole = value == int(value) and isinstance(getattr(STANDARD, knob, None), int)
        plain = int(value) if whole else value
        more = {_CROP: value} if knob == _CROP else {"render": {**setting.render, knob: plain}}
        written.append(setting.model_copy(update={**changes, **more}))
    return written
