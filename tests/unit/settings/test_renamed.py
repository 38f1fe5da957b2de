"""Older names of the renderer's settings: refused with the new name, and read from older folders."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.render.settings import PAPER, REFERENCE, STANDARD
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.schema.config import AccuracyConfig
from shift3d.task.assets import render_settings
from shift3d.task.spec import TaskSpec

RENAMED = {
    "unchecked_m": "final_newton_m",
    "coarse_band_m": "bfloat16_band_m",
    "grazing_floor": "min_n_dot_d",
    "look_between": "local_minima",
    "empty_space": "sdf_grid",
}


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
@pytest.mark.parametrize("value", [0.0, True, None])
def test_an_older_name_is_refused_with_the_new_one(old: str, new: str, value: Any) -> None:
    assert new in vars(STANDARD)
    with pytest.raises(InputError, match=rf"^accuracy\.render\.{old} is called {new}\."):
        accuracy_settings(AccuracyConfig(name="standard", render={old: value}))


@pytest.mark.parametrize(
    ("render", "message"),
    [
        ({"root": "itp"}, "accuracy.render.root is gone: there is one root finder"),
        ({"warm_gap_m": 0.03}, "accuracy.render.warm_gap_m is gone: a warm rendering"),
        ({"solver": "hybrid"}, "accuracy.render.solver=hybrid is called sphere_tracing"),
        ({"solver": "exact"}, "accuracy.render.solver=exact is called piecewise_linear"),
        ({"solver": "march"}, "accuracy.render.solver=march is gone: plain_sphere_tracing"),
    ],
)
def test_what_is_gone_says_why_and_a_solver_what_it_is_called(render: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        accuracy_settings(AccuracyConfig(name="standard", render=render))
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("accuracy.render.grazing_floor=0", "accuracy.render.grazing_floor is called min_n_dot_d"),
        ("+accuracy.render.grazing_floor=0", "accuracy.render.grazing_floor is called min_n_dot_d"),
        ("accuracy.render.root=itp", "accuracy.render.root is gone"),
        ("accuracy.render.solver=hybrid", "is called sphere_tracing"),
        ("accuracy.render.grazing=0", "One of: "),
        ("attack.steady_steps=1", "attack.steady_steps is called selection_window"),
        ("attack.sphere_m=7", "attack.sphere_m is gone"),
        ("effects=silent_beams", "effects=silent_beams is called no_return_beams"),
        ("effects=[fog,silent_beams]", "effects=silent_beams is called no_return_beams"),
    ],
)
def test_the_command_says_it_in_one_line(override: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "smoke", override]) == 2
    printed = capsys.readouterr().err
    assert message in printed and printed.count("\n") == 1


def task(accuracy: str, **settings: Any) -> TaskSpec:
    names = ("vehicle", "scene", "dataset", "detector")
    settings = {"dtype": "float32", "detector": "float32", **settings}
    return TaskSpec(
        **dict.fromkeys(names, "x"),
        accuracy=accuracy,
        mode="pose",
        lambda_=None,
        alpha=0.01,
        accuracy_settings=settings,
    )


# Presets as the older program stated them, where a name or a value has changed.
OLD_STANDARD = {"solver": "hybrid", "root": "anderson_bjorck", "unchecked_m": 3e-4, "warm_gap_m": 0.03, "batch": 256}
OLD_STANDARD |= {"grazing_floor": 0.2, "look_between": True, "empty_space": True, "coarse_band_m": 0.02}
OLD_PAPER = {"solver": "paper", "root": "bisection", "step_m": 0.1, "tolerance_m": 1e-6, "unchecked_m": 0.0}
OLD_PAPER |= {"max_iterations": 30, "warm_start": False, "grazing_floor": 0.0, "batch": 16384, "empty_space": False}
OLD_PAPER |= {"coarse_band_m": 0.0}
OLD_REFERENCE = {"solver": "exact", "dtype": "float64", "step_m": 0.005, "max_step_m": 0.05, "step_safety": 0.5}
OLD_REFERENCE |= {"tolerance_m": 1e-9, "unchecked_m": 0.0, "max_iterations": 80, "box_margin_m": 0.3}
OLD_REFERENCE |= {"warm_start": False, "empty_space": False, "coarse_band_m": 0.0}


def test_the_settings_of_an_older_folder_are_read() -> None:
    assert render_settings(task("standard", **OLD_STANDARD)) == STANDARD.with_(final_newton_m=3e-4)
    assert render_settings(task("paper", **OLD_PAPER)) == PAPER
    assert render_settings(task("reference", **OLD_REFERENCE)) == REFERENCE
    changed = render_settings(task("standard", **OLD_STANDARD | {"grazing_floor": 0.05, "dtype": "float64"}))
    assert (changed.min_n_dot_d, changed.dtype) == (0.05, torch.float64)


def test_an_older_task_keeps_its_id() -> None:
    spec = task("standard", **OLD_STANDARD)
    render_settings(spec)
    assert TaskSpec.from_dict(spec.to_dict()).task_id == spec.task_id and "unchecked_m" in spec.accuracy_settings


def test_a_solver_that_is_gone_names_the_task() -> None:
    with pytest.raises(InputError, match=r"^task [0-9a-f]{32}: the renderer has no solver 'march' any more"):
        render_settings(task("standard", solver="march"))
