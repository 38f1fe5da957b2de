"""Fine-tuning on a real, small sweep: the same bytes, stable objects alone, provenance, and a better score."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from cheap_sweeps import CHEAP, set_stable
from safetensors.torch import load_file

from shift3d.cli.command import run_command
from shift3d.cli.commands import sweep
from shift3d.cli.commands.detectors import evaluate, train
from shift3d.detectors.models.weights import WEIGHTS_FOLDER, load_network
from shift3d.errors import InputError
from shift3d.finetuning.objects import scored_objects, stable_objects
from shift3d.finetuning.rescoring import attacked_scores, rescore_objects
from shift3d.finetuning.tune import RATE, object_scenes, objects_digest, tuning_recipe
from shift3d.geometry.boxes import points_in_boxes
from shift3d.settings.catalogue.detector_files import file_hash
from shift3d.store.tables import read_table, table_from_rows, write_table
from shift3d.training.command import TrainOptions
from shift3d.training.detector.recipes import RECIPES
from shift3d.training.detector_scenes import load_cached

SHIPPED = WEIGHTS_FOLDER / "pointpillars.safetensors"
FEW = ("threads=1", "device=cpu", "mlflow=none", "recipe.crop_cells=64", "recipe.jitter_m=4", "recipe.pasted=0")


def tuned(attacked: Path, out: Path, *words: str) -> Path:
    command = ["model=pointpillars", f"finetune={attacked}", *FEW, *words, f"out={out}"]
    assert run_command(train.COMMAND, command) == 0
    return out / "pointpillars.safetensors"


@pytest.fixture(scope="module")
def weights(_attacked: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights after one epoch; tests only read them."""
    out = tmp_path_factory.mktemp("tuned")
    return tuned(_attacked, out, "recipe.peak_rate=2e-5", "recipe.seed=3")


def test_the_same_command_again_leaves_the_same_bytes(_attacked: Path, weights: Path) -> None:
    """tests/service/test_finetune_resumes.py checks that another folder gets the same bytes."""
    words = ("recipe.peak_rate=2e-5", "recipe.seed=3")
    before = weights.read_bytes()
    assert tuned(_attacked, weights.parent, *words).read_bytes() == before, "what is finished is finished again"
    assert np.array([1e-310]) * 1.0 > 0.0, "what is measured next computes with subnormal numbers"
    with pytest.raises(InputError, match="another recipe"):
        tuned(_attacked, weights.parent, "recipe.peak_rate=1e-3", "recipe.seed=3")


def test_every_detector_is_tuned_at_one_pace_on_shapes_in_their_own_proportions(tmp_path: Path) -> None:
    recipes = [tuning_recipe(name, 10, TrainOptions(tmp_path)) for name in RECIPES]
    assert {(recipe.batch, recipe.peak_rate, recipe.seed, recipe.steps) for recipe in recipes} == {(2, RATE, 0, 10)}
    assert {recipe.augmentation.object_stretch for recipe in recipes} == {(1.0, 1.0)}


def test_objects_of_other_codes_or_poses_are_other_objects(_attacked: Path) -> None:
    """The same sweep run by another version gives the same tasks: their scenes and checkpoints must not be reused."""
    found = scored_objects(_attacked, "pointpillars", ("adversarial",))
    row = found.objects[0]
    digests = {objects_digest(found)}
    for name in ("latent_code", "yaw_rad"):
        value = row.solution[name]
        other = [*value[:-1], np.nextafter(value[-1], 9.0)] if isinstance(value, list) else np.nextafter(value, 9.0)
        moved = replace(row, solution={**row.solution, name: other})
        digests.add(objects_digest(replace(found, objects=(moved, *found.objects[1:]))))
    assert len(digests) == 3 and objects_digest(found) in digests


def test_provenance_names_the_sweep_its_rows_and_what_was_left_out(_attacked: Path, weights: Path) -> None:
    facts = json.loads(weights.with_suffix(".json").read_text())
    rows = pq.read_table(_attacked / "final" / "solutions.parquet").to_pylist()
    wanted = [[row["task_id"], 0] for row in rows if row["vehicle"] == "suv" and row["method"] == "adversarial"]
    source = facts["finetuned_on"]
    assert source["rows"] == wanted and source["vehicles"] == {"suv": 1} and source["left_out"] == {"unstable": 1}
    assert (source["sweep"], source["method"], source["objects"]) == ("finetune", "adversarial", 1)
    assert _attacked.joinpath("spec.yaml").read_text().count(source["spec_hash"]) == 1
    assert (facts["rate"], facts["seed"], facts["steps"]) == (2e-5, 3, 1), "one object, half of the crops: one step"
    assert facts["started_from"] == {"file": SHIPPED.name, "blake2b": file_hash(SHIPPED)}


def test_at_next_to_no_rate_the_detector_stays_the_one_it_was(attacked: Path, tmp_path: Path) -> None:
    """Batch statistics do not change either: a measured difference is an effect of the objects alone."""
    found = load_file(tuned(attacked, tmp_path / "out", "steps=1", "recipe.peak_rate=1e-30"))
    before = load_network(SHIPPED, "pointpillars").state_dict()
    assert found.keys() == before.keys()
    assert all(torch.allclose(found[name].double(), before[name].double(), rtol=0, atol=1e-20) for name in found)


def test_some_steps_on_one_object_raise_its_score(attacked: Path, tmp_path: Path) -> None:
    weights = tuned(attacked, tmp_path / "out", "steps=4", "recipe.peak_rate=2e-4", "recipe.inserted_share=1")
    found = stable_objects(attacked, "pointpillars", file_hash(SHIPPED), "adversarial")
    unseen = weights.with_name("no_provenance.safetensors")
    unseen.write_bytes(weights.read_bytes())
    scores = rescore_objects(attacked, "pointpillars", unseen).to_pandas().set_index(["task_id", "method"])["score"]
    assert scores[found.objects[0].key[:2]] > found.objects[0].score + 0.02


def test_a_training_scene_holds_the_object_as_it_was_attacked(attacked: Path, tmp_path: Path) -> None:
    found = stable_objects(attacked, "pointpillars", file_hash(SHIPPED), "adversarial")
    (file,) = object_scenes(tmp_path, found)
    scene, row = load_cached(file), found.objects[0]
    before = found.assets_of(row).scene(row.spec)[0]
    pose = [row.solution[name] for name in ("x_m", "y_m", "yaw_rad")]
    assert scene.boxes[-1, [0, 1, 6]] == pytest.approx(pose, abs=1e-5)
    assert len(scene.boxes) == len(before.labels.of_class("vehicle")) + 1
    scores = pq.read_table(attacked / "final" / "scores.parquet").to_pandas().set_index(["task_id", "method"])
    points = scores.loc[row.key[:2], "object_points"]
    assert points_in_boxes(scene.points, scene.boxes[-1:], 0.3).sum() >= 0.95 * points
    near = np.abs(before.points[before.has_beam][:, :2]).max(axis=1) < 80.0
    assert abs(len(scene.points) - near.sum()) <= points, "beams move, none is added"


def test_weights_of_the_sweep_give_its_own_scores(held_out: Path) -> None:
    assert rescore_objects(held_out, "pointpillars", SHIPPED).equals(attacked_scores(held_out, "pointpillars", SHIPPED))


def test_an_adaptive_attack_on_weights_that_were_replaced_since_is_no_score_of_theirs(held_out: Path) -> None:
    other = SHIPPED.with_name("sst_small.safetensors")
    with pytest.raises(InputError, match=f"attacked other weights of pointpillars than {other} holds"):
        attacked_scores(held_out, "pointpillars", other)


def test_a_control_is_tuned_on_the_tasks_that_the_tuning_is(attacked: Path) -> None:
    """A suv whose found shape is unstable is in neither training, even if its unchanged shape is stable."""
    path = attacked / "final" / "scores.parquet"
    table = read_table(path, "scores").to_pylist()
    rows = [row | {"stable": row["vehicle"] == "suv" or row["method"] == "baseline"} for row in table]
    write_table(path, table_from_rows("scores", rows))
    tuned_on, control = (
        stable_objects(attacked, "pointpillars", file_hash(SHIPPED), method) for method in ("adversarial", "baseline")
    )
    assert [row.spec.vehicle for row in control.objects] == ["suv"]
    assert [row.spec.task_id for row in control.objects] == [row.spec.task_id for row in tuned_on.objects]
    assert {row.solution["method"] for row in control.objects} == {"baseline"}
    assert control.left_out == tuned_on.left_out == {"unstable": 1}


def test_scenes_that_were_tuned_on_are_refused_by_name(attacked: Path, weights: Path, tmp_path: Path) -> None:
    name = "street-train-hdl64-000000"
    with pytest.raises(InputError, match=f"was fine-tuned on {name}"):
        rescore_objects(attacked, "pointpillars", weights)
    words = ["detector=pointpillars", "sensor=hdl64", "split=train", "count=1", f"weights={weights}"]
    with pytest.raises(InputError, match=f"was fine-tuned on {name}"):
        run_command(evaluate.COMMAND, [*words, f"out={tmp_path / 'natural'}"])
    assert not (tmp_path / "natural").exists() or not any((tmp_path / "natural").iterdir())


def test_what_weights_were_tuned_on_is_not_forgotten_by_a_training_from_them(
    attacked: Path, weights: Path, tmp_path: Path
) -> None:
    few = (*FEW, "steps=0", "recipe.settle_steps=1", "recipe.statistics_crops=1", "count=1", "inserted=0")
    words = ("model=pointpillars", *few, f"start_from={weights}", f"out={tmp_path}")
    assert run_command(train.COMMAND, words) == 0
    again = tmp_path / "pointpillars.safetensors"
    facts = json.loads(again.with_suffix(".json").read_text())
    assert facts["before"] == json.loads(weights.with_suffix(".json").read_text())
    with pytest.raises(InputError, match="was fine-tuned on street-train-hdl64-000000"):
        rescore_objects(attacked, "pointpillars", again)


def test_unusable_sweeps_are_one_clear_line(attacked: Path, held_out: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    verified = Path(shutil.copytree(held_out, tmp_path / "verified"))
    set_stable(verified, {"suv": True})
    with pytest.raises(InputError, match="street of split test, not train"):
        tuned(verified, out)
    with pytest.raises(InputError, match=r"not verified.*shift3d verify"):
        tuned(held_out, out)
    with pytest.raises(InputError, match="attacked pointpillars, not sst"):
        run_command(train.COMMAND, ["model=sst", f"finetune={attacked}", *FEW, f"out={out}"])
    with pytest.raises(InputError, match="attacked other weights of pointpillars"):
        other = tmp_path / "other.safetensors"
        other.write_bytes(WEIGHTS_FOLDER.joinpath("sst_small.safetensors").read_bytes())
        tuned(attacked, out, f"start_from={other}")
    with pytest.raises(InputError, match=r"no such weights"):
        tuned(attacked, out, f"start_from={tmp_path / 'none.safetensors'}")
    with pytest.raises(InputError, match="inserted_share=0 leaves no object"):
        tuned(attacked, out, "recipe.inserted_share=0")
    with pytest.raises(InputError, match="means nothing with finetune="):
        tuned(attacked, out, "scenes=kitti")
    with pytest.raises(InputError, match=r"recipe\.steps= means nothing with finetune=.*Give steps=N"):
        tuned(attacked, out, "recipe.steps=7")
    with pytest.raises(InputError, match=r"recipe\.anchor_size_m= means nothing with finetune="):
        tuned(attacked, out, "recipe.anchor_size_m=6,2.4,2.2")
    with pytest.raises(InputError, match=r"recipe\.mesh_only_steps= means nothing with finetune="):
        tuned(attacked, out, "recipe.mesh_only_steps=1")
    with pytest.raises(InputError, match="steps=0 tunes nothing"):
        tuned(attacked, out, "steps=0", f"start_from={SHIPPED}")
    set_stable(attacked, {"suv": False, "coupe": False})
    with pytest.raises(InputError, match="no adversarial object is stable"):
        tuned(attacked, out)
    (attacked / "final" / "solutions.parquet").unlink()
    with pytest.raises(InputError, match="the sweep is not finished"):
        tuned(attacked, out)
    with pytest.raises(InputError, match=str(tmp_path / "empty")):
        tuned(tmp_path / "empty", out)
    assert not (out / "pointpillars.safetensors").exists()


def test_a_sweep_in_which_nothing_found_a_place_is_refused(tmp_path: Path) -> None:
    words = ["finetune", *CHEAP, "vehicle=suv", "attack.placement.min_object_points=100000"]
    assert run_command(sweep.COMMAND, [*words, "attack.placement.attempts=3", f"out={tmp_path / 'sweep'}"]) == 3
    with pytest.raises(InputError, match="no task has a scored adversarial object"):
        tuned(tmp_path / "sweep", tmp_path / "out")
