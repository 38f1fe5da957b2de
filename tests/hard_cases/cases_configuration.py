"""Hard cases of sweep files, overrides and settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from catalogue import hard_case
from clear_errors import place, refused
from valid_settings import installed, settings, write_installation

from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.expand import expand
from shift3d.settings.schema.config import AccuracyConfig, Config

AREA = "configuration"
HERE = "sweep mine"


def composed(*words: str, change: Callable[[Path], object] = lambda folder: None) -> list[Config]:
    """Compose the small installation's sweep with overrides, after a change of its files."""
    with place() as folder:
        write_installation(folder)
        change(folder)
        with installed(folder):
            return list(expand(compose_sweep("mine", words)))


def accuracy(**render: bool | int | float | str) -> object:
    return accuracy_settings(AccuracyConfig(name="standard", render=dict(render)))


def put(name: str, value: object) -> dict[str, object]:
    """Return complete settings with one of them replaced."""
    values = settings()
    *parents, leaf = name.split(".")
    inner = values
    for parent in parents:
        inner = inner[parent]
    inner[leaf] = value
    return values


@hard_case(
    area=AREA,
    why="a misspelt setting that were ignored would measure something else than was requested",
    must="an error that names it, and what there is",
    guard="the schema forbids what it does not know, and the error says so",
)
def a_setting_that_does_not_exist() -> None:
    values = settings()
    values["attack"]["stpes"] = 5
    refused(lambda: validate(values, HERE), HERE, "no setting attack.stpes", "Did you mean 'attack.steps'? One of: ")


@hard_case(
    area=AREA,
    why="by _target_ Hydra calls any function",
    must="an error: configuration names no code",
    guard="Hydra's refusal becomes one line with the settings there are",
)
def a_setting_that_would_call_a_function() -> None:
    refused(lambda: composed("vehicle._target_=os.system"), HERE, "unknown setting 'vehicle._target_'", "vehicle.name")
    values = settings()
    values["vehicle"]["_target_"] = "os.system"
    refused(lambda: validate(values, HERE), "vehicle._target_")


@hard_case(
    area=AREA,
    why="true counts as 1, and 'many' as nothing",
    must="an error that names the setting and the kind of its value",
    guard="a setting of the renderer must have the type of the preset's",
)
def a_renderer_setting_of_another_type() -> None:
    for name, value in (("max_iterations", 2.5), ("batch", True), ("step_m", "wide"), ("warm_start", 1)):
        refused(lambda name=name, value=value: accuracy(**{name: value}), f"accuracy.render.{name}")
    for name, wrong in (("attack.steps", True), ("attack.alpha", "0.01"), ("seed", 1.0)):
        refused(lambda name=name, wrong=wrong: validate(put(name, wrong), HERE), HERE, name)


@hard_case(
    area=AREA,
    why="a task's id is the hash of JSON, which has no infinity and no NaN; NaN also compares false with every limit",
    must="an error that names the setting",
    guard="numbers for the renderer must be finite",
)
def a_renderer_setting_that_is_infinite() -> None:
    for name, value in (("max_slope", float("inf")), ("min_n_dot_d", float("inf")), ("step_m", float("nan"))):
        refused(lambda name=name, value=value: accuracy(**{name: value}), "accuracy.render", name, str(value))
    refused(lambda: validate(put("attack.alpha", float("nan")), HERE), "attack.alpha", "finite")


@hard_case(
    area=AREA,
    why="a step of less than nothing never arrives; without a check, workers would find out task by task",
    must="an error while the sweep is planned, naming the setting",
    guard="the renderer's own check is made with the plan",
)
def a_renderer_setting_below_zero() -> None:
    for name, value in (("step_m", -0.02), ("step_m", 0.0), ("max_iterations", -1), ("batch", 0), ("dtype", "float8")):
        refused(lambda name=name, value=value: accuracy(**{name: value}), "accuracy.render", name)


@hard_case(
    area=AREA,
    why="a march in steps of a nanometre holds 10^11 samples of one beam, and a search down to 1e-11 m does not end",
    must="an error while the sweep is planned, naming the setting; a hundredth of a millimetre is taken",
    guard="a step must not be shorter than a hundredth of a millimetre",
)
def a_renderer_step_of_a_nanometre() -> None:
    for step_m in (1e-9, 1e-11, 1e-300):
        refused(lambda step_m=step_m: accuracy(step_m=step_m), "accuracy.render", "step_m")
    accuracy(step_m=1e-5)


@hard_case(
    area=AREA,
    why="from 50 m to 15 m there is no place, and every task would report that nothing fits",
    must="an error that names both limits",
    guard="the near limit must be below the far one",
)
def a_placement_ring_without_a_place() -> None:
    refused(lambda: validate(put("attack.placement.min_range_m", 50.0), HERE), HERE, "min_range_m", "max_range_m")


@hard_case(
    area=AREA,
    why="an interval has no list of values: a sweep over it has no end",
    must="an error that names the axis and how to list values",
    guard="only axes of single values are taken",
)
def an_axis_without_steps() -> None:
    refused(lambda: composed("attack.alpha=interval(0,1)"), HERE, "attack.alpha", "continuous axis")


@hard_case(
    area=AREA,
    why="a pattern that fits nothing is an axis of no values, and the product with it is a sweep of no tasks",
    must="an error that names the axis",
    guard="every axis must have a value",
)
def an_axis_without_values() -> None:
    refused(lambda: composed("vehicle=glob(zeppelin*)"), HERE, "vehicle", "no value")


@hard_case(
    area=AREA,
    why="${scene} as the scene's name refers to itself, and to an axis it would have another value in every task",
    must="an error that names the setting",
    guard="interpolations are refused before anything is resolved",
)
def a_setting_that_refers_to_itself() -> None:
    for word in ("scene=${scene}", "vehicle.name=${mode}", "detector.weights=${oc.env:HOME}"):
        refused(lambda word=word: composed(word), HERE, word.partition("=")[0], "interpolation")


@hard_case(
    area=AREA,
    why="Hydra passes on what the YAML reader raises, and ValueErrors of its own",
    must="an error of one line that names the sweep and the place",
    guard="whatever composing raises becomes ours",
)
def a_sweep_file_that_is_no_yaml() -> None:
    for content in (
        b"a: b: c\n",
        b"defaults: 3\n",
        b"\xff\xfe\x00",
        b"- 1\n- 2\n",
        b"defaults:\n- 1.5: x\n",
        b"a: [1\n",
    ):
        spoil = lambda folder, content=content: (folder / "sweeps" / "mine.yaml").write_bytes(content)  # noqa: E731
        refused(lambda spoil=spoil: composed(change=spoil), HERE)


@hard_case(
    area=AREA,
    why="a setting that must be given stands as ??? in the files, which is also a text",
    must="an error that says how to give it",
    guard="the mark is looked for before the schema takes it for a name",
)
def a_setting_that_was_never_given() -> None:
    refused(lambda: validate(put("vehicle.name", "???"), HERE), HERE, "vehicle.name is required", "vehicle.name=VALUE")
