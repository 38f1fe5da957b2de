"""A sweep with meaningless numbers says so, whatever its name, and names the command for meaningful ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pandas as pd
import pytest
import valid_sweeps

from shift3d.analysis.html.report import report_page
from shift3d.analysis.results import read_sweep
from shift3d.analysis.tables.coverage import small_sweep_warning, unresponsive_detectors, unscored_tasks
from shift3d.errors import InputError
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.planning.plan_view import plan_lines, plan_summary
from shift3d.sweep.planning.tasks import merged_settings
from shift3d.sweep.retrieval import pool_plan


def caveat(name: str, *overrides: str) -> str | None:
    return small_sweep_warning(make_plan(compose_sweep(name, ["vehicle=suv", *overrides]), valid_sweeps.catalogue)[0])


@pytest.mark.parametrize("words", [["smoke"], ["default", "attack.steps=5"], ["default", "attack.steps=0,5"]])
def test_a_search_that_is_cut_short_is_said(words: list[str]) -> None:
    message = caveat(*words)
    assert message and "mean nothing, with a search of 5 steps (the paper's: 40)" in message
    assert message.endswith("For meaningful AUCs: shift3d sweep")


def test_the_suggested_command_keeps_the_vehicles() -> None:
    message = small_sweep_warning(
        make_plan(compose_sweep("smoke", ["vehicle=wide", "vehicle.name=suv"]), valid_sweeps.catalogue)[0]
    )
    assert message and message.endswith("shift3d sweep vehicle=wide vehicle.name=NAME")


def test_too_few_scenes_are_said_whatever_the_search() -> None:
    message = caveat("default")
    assert message and "2 scenes (at least 4)" in message and "steps" not in message


def test_random_draws_and_edits_have_no_steps_to_be_short_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valid_sweeps, "SCENES", ("north", "south", "east", "west"))
    assert caveat("default", "attack.search=random", "attack.steps=1", "mode=shape", "attack.space=pca") is None
    edit = ("vehicle=wide", "vehicle.name=suv", "mode=shape", "attack.edit=chassis.height_m:1")
    assert caveat("default", *edit, "attack.steps=0") is None
    assert "a search of 2 steps" in (caveat("default", *edit, "attack.steps=2") or "")


def test_where_shapes_may_go_makes_no_further_task_of_a_pose() -> None:
    words = ["vehicle=suv", "mode=pose", "attack.search=descent", "attack.space=free,pca", "attack.components=3"]
    many = make_plan(compose_sweep("default", [*words, "attack.naturalness=0,95"]), valid_sweeps.catalogue)[0]
    plain = make_plan(compose_sweep("default", ["vehicle=suv", "mode=pose"]), valid_sweeps.catalogue)[0]
    assert many.tasks.ids.equals(plain.tasks.ids)


def test_settings_that_no_column_tells_apart_are_named() -> None:
    plan = make_plan(compose_sweep("default", ["vehicle=suv", "attack.steps=5,40"]), valid_sweeps.catalogue)[0]
    assert merged_settings(plan.tasks) == ["attack.steps"]
    assert "AUCs average over attack.steps: no table column separates their values" in plan_summary(plan)
    fog = ["vehicle=suv", "effects=fog", "effects.visibility_m=50,100"]
    assert merged_settings(make_plan(compose_sweep("default", fog), valid_sweeps.catalogue)[0].tasks) == [
        "effects.visibility_m"
    ]
    either = ["vehicle=suv", "effects=fog,none", "effects.visibility_m=50"]
    assert merged_settings(make_plan(compose_sweep("default", either), valid_sweeps.catalogue)[0].tasks) == []
    words = ["vehicle=suv", "attack.lambda=1,10", "attack.alpha=0.01,0.02", "replicate=0,1", "seed=0,1"]
    assert merged_settings(make_plan(compose_sweep("default", words), valid_sweeps.catalogue)[0].tasks) == []


def test_an_axis_that_a_search_does_not_use_is_named() -> None:
    words = ["vehicle=suv", "mode=shape", "attack.search=descent,evolution", "attack.alpha=0.01,0.1"]
    shown = plan_summary(make_plan(compose_sweep("default", words), valid_sweeps.catalogue)[0])
    assert "2 values of attack.alpha make equal tasks under attack.search=evolution, which does not use it" in shown
    assert "attack.search=descent" not in shown
    starts = ["vehicle=suv", "mode=shape", "attack.starts=1,5", "attack.components=3,4"]
    shown = plan_summary(make_plan(compose_sweep("default", starts), valid_sweeps.catalogue)[0])
    assert "attack.starts make equal tasks under attack.search=descent" in shown
    assert "attack.components make equal tasks under attack.space=free" in shown


def two_folders(config: Config) -> Catalogue:
    """Return frames of the same names with other contents under another seed, like two folders of frames."""
    found = valid_sweeps.catalogue(config)
    other = [
        dataclasses.replace(entry, content_hash=f"{entry.content_hash}{config.scenes.seed}") for entry in found.scenes
    ]  # type: ignore[union-attr]
    return dataclasses.replace(found, scenes=tuple(other))


def test_frames_of_one_name_are_said_and_make_no_pool() -> None:
    words = ["vehicle=suv", "scenes.seed=0,1", "attack.lambda=1,10"]
    plan = make_plan(compose_sweep("default", words), two_folders)[0]
    names = [("street-hdl64", name) for name in valid_sweeps.SCENES]
    assert plan.tasks.ambiguous_scenes() == names
    line = "2 scene names (e.g. street-hdl64/north, street-hdl64/south) refer to several frames"
    assert line in plan_summary(plan)
    with pytest.raises(InputError, match="two scenes of street-hdl64 are called north"):
        pool_plan(plan)
    alone = make_plan(compose_sweep("default", words), valid_sweeps.catalogue)[0]
    assert alone.tasks.ambiguous_scenes() == [] and len(pool_plan(alone).tasks) == 2


def test_the_list_of_tasks_says_what_no_column_tells() -> None:
    words = ["vehicle=suv", "mode=shape", "attack.selection_window=0,1", "attack.search=descent,random"]
    plan = make_plan(compose_sweep("default", words), valid_sweeps.catalogue)[0]
    assert len(set(plan.tasks.ids.to_pylist())) == len(plan.tasks) == 4 * len(valid_sweeps.SCENES)
    assert "AUCs average over attack.selection_window: no table column" in plan_summary(plan)
    lines = [line.split("  ", 1)[1] for line in plan_lines(plan)]
    assert len(set(lines)) == len(lines), "each line differs in more than its id"
    assert lines[0].endswith("descent  attack.selection_window=0") and lines[-1].endswith(
        "random  attack.selection_window=1"
    )
    one = make_plan(compose_sweep("default", words[:2]), valid_sweeps.catalogue)[0]
    assert not any("attack." in line or "descent" in line for line in plan_lines(one))


def test_tasks_without_a_score_are_said_first() -> None:
    scores = pd.DataFrame({"task_id": ["a", "a", "b"], "score": [0.5, 0.4, None]})
    assert unscored_tasks(scores, 3) == "2 of 3 tasks have no score", "b found no place, the third was quarantined"
    assert unscored_tasks(scores, 1) is None


def test_a_sweep_with_scenes_and_steps_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valid_sweeps, "SCENES", ("north", "south", "east", "west"))
    assert caveat("default") is None
    assert caveat("default", "attack.steps=5,40") is None, "of several searches one is whole"


def scored(*rows: tuple[str, str, float | None, int]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["task_id", "scored_by", "score", "object_points"])


def test_a_detector_that_changes_leave_unmoved_is_named() -> None:
    blind = [("a", "own", 0.6, 400), ("a", "own", 0.6, 200), ("b", "own", 0.4, 300), ("b", "own", 0.4, 310)]
    seeing = [("a", "sst", 0.6, 400), ("a", "sst", 0.5, 200), ("b", "sst", 0.4, 300), ("b", "sst", 0.4, 310)]
    message = unresponsive_detectors(scored(*blind, *seeing))
    assert message and message.startswith("own: ") and "frame" in message and "sst" not in message


def test_vehicles_that_did_not_change_or_have_no_score_say_nothing_of_the_detector() -> None:
    assert unresponsive_detectors(scored(("a", "own", 0.6, 400), ("a", "own", 0.6, 400))) is None
    assert unresponsive_detectors(scored(("a", "own", None, 400), ("a", "own", None, 200))) is None
    assert unresponsive_detectors(scored()) is None


def test_the_report_begins_with_it(finished: Path) -> None:
    sweep = read_sweep(finished)
    blind = sweep.scores.assign(score=0.5, object_points=range(len(sweep.scores)))
    page = report_page(dataclasses.replace(sweep, scores=blind), cases=0)
    assert page.index("Does the detector see the vehicle at all?") < page.index("The hard cases</h2>")


def test_the_report_says_at_its_beginning_how_to_find_shapes_that_stay_vehicles(finished: Path) -> None:
    sweep = read_sweep(finished)
    page = report_page(dataclasses.replace(sweep, scores=sweep.scores.assign(natural=False)), cases=0)
    assert page.index("shift3d sweep natural.") < page.index("The hard cases</h2>")
    assert "SWEEP=natural" not in report_page(sweep, cases=0)
