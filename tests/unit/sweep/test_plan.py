"""The plan: three tasks per vehicle and scene, in order, each once."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path

import pytest
import valid_sweeps
from by_hand import BOTH_LAMBDAS, VEHICLES, catalogue

from shift3d.errors import InputError
from shift3d.settings.catalogue.compiled import refuse_gradient_search
from shift3d.settings.catalogue.reading import Catalogue, read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.store.schemas import SCHEMA_VERSION
from shift3d.sweep.planning import folder as folder_module
from shift3d.sweep.planning.folder import open_folder, read_plan
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.sweep.planning.plan_view import plan_lines, plan_summary
from shift3d.sweep.planning.spec_file import read_spec


def test_shape_under_two_lambda_and_pose_once(default_plan: Plan) -> None:
    specs = [task.spec for task in default_plan.tasks]
    assert len(specs) == 5 * 2 * 3 == len({spec.task_id for spec in specs})
    for vehicle in VEHICLES:
        for scene in ("north", "south"):
            here = [(s.mode, s.lambda_) for s in specs if (s.vehicle, s.scene) == (vehicle, scene)]
            assert here == [("shape", 1.0), ("shape", 10.0), ("pose", None)]
    assert [spec.vehicle for spec in specs[::6]] == list(VEHICLES)


def test_the_spec_holds_what_the_catalogue_says(suv_plan: Plan) -> None:
    spec = suv_plan.tasks[0].spec
    assert (spec.scene_hash, spec.vehicle_hash, spec.decoder_hash) == ("n", "suv-hash", "d")
    assert spec.scored_by == ("pointpillars",) and spec.detector_hashes == {"pointpillars": "p"}
    assert (spec.placement.sector_centre_rad, spec.placement.sector_half_width_rad) == (0.5, 1.0)
    assert spec.accuracy_settings == {"step_m": 0.02}
    assert (spec.attack.steps, spec.alpha, spec.placement.min_object_points) == (40, 0.01, 300)


def test_common_settings_are_those_of_every_task(default_plan: Plan) -> None:
    common = default_plan.common_settings
    assert (default_plan.settings["attack"]["lambda"], default_plan.settings["vehicle"]["name"]) == (1.0, "coupe")
    assert common.keys() == default_plan.settings.keys() - {"vehicle", "mode"}
    assert common["attack"] == {n: v for n, v in default_plan.settings["attack"].items() if n != "lambda"}


def test_execution_settings_change_no_id(suv_plan: Plan) -> None:
    words = [*BOTH_LAMBDAS, "vehicle=suv", "runner=local", "tracking=none", "scenes.count=9"]
    assert make_plan(compose_sweep("default", words), catalogue)[0].spec_hash == suv_plan.spec_hash


def test_other_settings_weights_and_names_change_the_hash(suv_plan: Plan) -> None:
    composed = compose_sweep("default", [*BOTH_LAMBDAS, "vehicle=suv"])
    others = [
        make_plan(compose_sweep("default", [*BOTH_LAMBDAS, "vehicle=suv", "seed=1"]), catalogue)[0],
        make_plan(composed, lambda config: dataclasses.replace(catalogue(config), detectors={"pointpillars": "new"}))[
            0
        ],
        make_plan(composed, lambda config: dataclasses.replace(catalogue(config), decoder_hash="new"))[0],
        make_plan(dataclasses.replace(composed, name="other"), catalogue)[0],
    ]
    assert len({plan.spec_hash for plan in [suv_plan, *others]}) == 5


def test_unknown_scene_and_vehicle() -> None:
    with pytest.raises(InputError, match=r"unknown scene 'nort'\. Did you mean 'north'"):
        make_plan(compose_sweep("default", ["scene=nort", "vehicle=suv"]), catalogue)
    with pytest.raises(InputError, match="unknown vehicle 'tram'"):
        make_plan(compose_sweep("default", ["vehicle=suv", "vehicle.name=tram"]), catalogue)
    with pytest.raises(InputError, match=r"2 vehicles have a name that begins with 'co'\. One of: coupe, convertible"):
        make_plan(compose_sweep("default", ["vehicle=suv", "vehicle.name=co"]), catalogue)
    short = make_plan(compose_sweep("default", ["vehicle=suv", "vehicle.name=beach"]), catalogue)[0]
    assert {task.spec.vehicle for task in short.tasks} == {"beach_wagon"}
    one = make_plan(compose_sweep("default", ["scene=south", "vehicle=suv"]), catalogue)[0]
    assert {task.spec.scene for task in one.tasks} == {"south"}


def test_a_vehicle_drawn_from_a_kind_is_planned_by_the_beginning_of_the_kinds_name() -> None:
    wide = compose_sweep("smoke", ["vehicle=wide", "vehicle.name=cam-2", "scenes.count=1"])
    preview = functools.partial(read_catalogue, preview=True)
    (task, *_) = make_plan(wide, preview)[0].tasks
    assert task.spec.vehicle == "camper-2"
    with pytest.raises(InputError, match=r"unknown vehicle 'lorry-2'"):
        make_plan(compose_sweep("smoke", ["vehicle=wide", "vehicle.name=lorry-2", "scenes.count=1"]), preview)


def test_what_is_loaded_is_shared_between_tasks_that_need_the_same() -> None:
    plan = make_plan(compose_sweep("default", ["scenes.sensor=hdl64,waymo_top", "vehicle=suv"]), catalogue)[0]
    assert [assets.scenes["sensor"] for assets in plan.assets] == ["hdl64", "waymo_top"]


def test_what_was_planned_goes_along_to_be_compared(suv_plan: Plan) -> None:
    (assets,) = suv_plan.assets
    assert assets.hashes == {"decoder": "d", "pointpillars": "p"}
    assert assets.vehicles == {"kind": "set", "folder": None} and assets.detectors == {"pointpillars": None}


def test_every_scoring_detectors_weights_change_the_tasks() -> None:
    composed = compose_sweep("default", ["vehicle=suv"])
    plans = [
        make_plan(composed, lambda config, found=found: dataclasses.replace(catalogue(config), detectors=found))[0]
        for found in ({"pointpillars": "p"}, {"pointpillars": "p", "sst": "s"}, {"pointpillars": "p", "sst": "t"})
    ]
    assert len({plan.spec_hash for plan in plans}) == 3
    assert plans[1].tasks[0].spec.scored_by == ("pointpillars", "sst")


def test_a_folder_of_an_older_version_is_refused(out: Path, suv_plan: Plan) -> None:
    open_folder(out, suv_plan)
    text = (out / "spec.yaml").read_text()
    (out / "spec.yaml").write_text(text.replace(f"schema_version: {SCHEMA_VERSION}", "schema_version: 2"))
    with pytest.raises(
        InputError, match=rf"schema version 2, this program reads 5 to {SCHEMA_VERSION}\. Use the version"
    ):
        open_folder(out, suv_plan)


def test_folder_and_back(out: Path, suv_plan: Plan) -> None:
    open_folder(out, suv_plan)
    assert read_plan(out) == suv_plan
    assert read_spec(out)["axes"] == {"vehicle": ["suv"], "mode": ["shape", "pose"], "attack.lambda": ["1", "10"]}
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    open_folder(out, suv_plan)
    assert before == {path.name: path.read_bytes() for path in out.iterdir()}


def test_tasks_under_another_name_of_their_effects_are_refused(out: Path) -> None:
    """The plan's hash is the same if no scene calls for an effect, but final tables would have other groups."""
    auto, none, both = (
        make_plan(compose_sweep("smoke", ["vehicle=suv", f"effects={word}"]), valid_sweeps.catalogue)[0]
        for word in ("auto", "none", "auto,none")
    )
    assert auto.spec_hash == none.spec_hash == both.spec_hash
    open_folder(out, auto)
    for other in (none, both):
        with pytest.raises(InputError, match="holds the same tasks, begun with effects=auto"):
            open_folder(out, other)
    open_folder(out, auto)
    (out / "env.json").unlink()  # its driver was killed before it had written everything: the plan's owner is not known
    open_folder(out, none)
    assert read_plan(out).tasks == none.tasks


def test_effects_in_another_order_are_the_same_sweep(out: Path) -> None:
    weather = ["effects.rain_mm_h=5", "effects.visibility_m=300"]
    plans = [
        make_plan(compose_sweep("smoke", ["vehicle=suv", f"effects={names}", *weather]), valid_sweeps.catalogue)[0]
        for names in ("[fog,rain]", "[rain,fog]")
    ]
    for plan in plans:
        open_folder(out, plan)


def test_a_folder_whose_first_driver_was_killed_early_is_taken_over(out: Path, suv_plan: Plan) -> None:
    out.mkdir()
    (out / "plan.parquet").write_bytes(b"another plan, without its spec.yaml")
    open_folder(out, suv_plan)
    assert read_plan(out) == suv_plan


def test_of_two_drivers_of_different_sweeps_one_has_the_folder_whole(
    out: Path, suv_plan: Plan, default_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second driver has checked the folder before the first wrote anything into it."""
    look = folder_module.check_folder

    def look_and_be_overtaken(place: object, plan: Plan) -> bool:
        begun = look(out, plan)
        if plan is default_plan and not begun:
            monkeypatch.setattr(folder_module, "check_folder", look)
            open_folder(out, suv_plan)
        return begun

    monkeypatch.setattr(folder_module, "check_folder", look_and_be_overtaken)
    with pytest.raises(InputError, match="holds another sweep"):
        open_folder(out, default_plan)
    assert read_plan(out) == suv_plan


def test_a_folder_whose_driver_was_killed_after_its_spec_is_completed(out: Path, suv_plan: Plan) -> None:
    open_folder(out, suv_plan)
    for name in ("plan.parquet", "env.json"):
        (out / name).unlink()
    open_folder(out, suv_plan)
    assert read_plan(out) == suv_plan and (out / "env.json").is_file()


def test_a_folder_names_the_instructions_that_decide_the_rounding_of_its_driver(out: Path, suv_plan: Plan) -> None:
    """Float32 logits of one scene differ between AVX2 and AVX-512 in their last digits."""
    import torch

    open_folder(out, suv_plan)
    found = json.loads((out / "env.json").read_bytes())["instructions"]
    assert found.startswith(torch.backends.cpu.get_cpu_capability()) and found.endswith(" bfloat16")


def test_every_value_of_an_axis_is_checked_against_the_detector() -> None:
    """An ONNX file has no gradient: no sweep of it may hold a search that follows one."""
    onnx = ["vehicle=suv", "mode=pose", "detector=onnx", "detector.file=x.onnx"]

    def checked(config: Config) -> Catalogue:
        refuse_gradient_search(config)
        return catalogue(config)

    for search in ("descent", "evolution,descent", "evolution,random,expectation"):
        with pytest.raises(InputError, match=r"attack\.search=evolution"):
            make_plan(compose_sweep("default", [*onnx, f"attack.search={search}"]), checked)
    plan, _ = make_plan(compose_sweep("default", [*onnx, "attack.search=evolution,random"]), checked)
    assert {task.assets for task in plan.tasks} == {0}


def test_damaged_folders_are_named(out: Path, suv_plan: Plan) -> None:
    with pytest.raises(InputError, match="it does not exist, or is empty"):
        read_plan(out)
    open_folder(out, suv_plan)
    (out / "plan.parquet").write_bytes(b"PAR1")
    with pytest.raises(InputError, match=r"plan\.parquet"):
        read_plan(out)
    (out / "spec.yaml").write_text("- a list")
    with pytest.raises(InputError, match="is not the spec of a sweep"):
        read_plan(out)


def test_in_words(suv_plan: Plan) -> None:
    counts, effects = plan_summary(suv_plan).splitlines()
    assert counts == "sweep default: 6 tasks (4 shape, 2 pose) of 1 vehicle in 2 scenes"
    assert effects == "effects: occlusion only; no scene needs another"
    lines = list(plan_lines(suv_plan))
    assert len(lines) == 6 and "lambda 10" in lines[2] and "lambda" not in lines[4]
