"""Training on scenes of any set: resumed, interrupted, recorded, and never over the shipped weights."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from shift3d.cli.commands.detectors.train import _options, _recipe_words
from shift3d.cli.main import main
from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.backbone import BackboneSpec
from shift3d.detectors.models.pillar_detectors import PointPillarsNet
from shift3d.detectors.models.sst import SstNet, SstSpec
from shift3d.detectors.models.window_transformer import TransformerSpec
from shift3d.errors import InputError
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.scene import Labels, Scene
from shift3d.training import command
from shift3d.training.checkpoints import read_checkpoint
from shift3d.training.compute import Compute, choose_compute
from shift3d.training.detector import loop as detector_loop
from shift3d.training.detector.loop import train_on_scenes
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector.recipes import RECIPES, scaled_to_steps
from shift3d.training.detector.train import scene_files, train_detector
from shift3d.training.detector.warm_start import start_state
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, cut_scene, from_scene, load_cached
from shift3d.training.progress import CurvePoint

PILLARS = BackboneSpec(in_channels=4, channels=(4, 4, 4), up_channels=4)
TOKENS = SstSpec(TransformerSpec(width=8, heads=2, feed_forward=8, blocks=1), encoder_hidden=4, out_channels=8)
TINY = Recipe(
    network=PILLARS,
    steps=6,
    settle_steps=3,
    mesh_only_steps=6,
    inserted_scenes=0,
    crop_cells=32,
    statistics_crops=2,
)
RECIPE = {
    "pointpillars": TINY,
    "centerpoint": dataclasses.replace(TINY, heads="centres"),
    "sst": dataclasses.replace(TINY, network=TOKENS, bfloat16=False),
}
each_detector = pytest.mark.parametrize("recipe", RECIPE.values(), ids=RECIPE.keys())

WINDOW = BevWindow(214, 214, 40, 40, 214, 214, 40, 40)
BOX = (8.0, 0.0, -0.93, 4.0, 1.8, 1.6, 0.0)


def _cloud(seed: int = 0, count: int = 3000) -> np.ndarray:
    """Return ground around the sensor, and a car-sized block of points ahead of it."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform((-30, -30, -1.75), (30, 30, -1.71), (count, 3))
    block = np.asarray(BOX[:3]) + rng.uniform(-0.5, 0.5, (300, 3)) * BOX[3:6]
    return np.concatenate((ground, block)).astype(np.float32)


def _scene(name: str) -> TrainingScene:
    points = _cloud(int(name)) + np.array((0, 0, 1.73), np.float32)
    return TrainingScene(points, np.array([BOX], np.float32) + np.float32([0, 0, 1.73, 0, 0, 0, 0]), 1.73)


def _kitti(root: Path) -> Path:
    """Write two frames in KITTI's layout, camera axes along the LiDAR's, a car 8 m ahead."""
    axes = "0 -1 0 0 0 0 -1 0 1 0 0 0"
    lines = f"P2: 700 0 600 0 0 700 180 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: {axes}\n"
    car = "Car 0.00 0 0.0 500 150 600 200 1.60 1.80 4.00 0.00 1.73 8.00 -1.570796\n"
    for part in ("velodyne", "calib", "label_2"):
        (root / "training" / part).mkdir(parents=True)
    for name in ("000003", "000008"):
        points = np.concatenate((_cloud(int(name)), np.full((3300, 1), 0.3)), axis=1)
        points.astype("<f4").tofile(root / "training" / "velodyne" / f"{name}.bin")
        (root / "training" / "calib" / f"{name}.txt").write_text(lines)
        (root / "training" / "label_2" / f"{name}.txt").write_text(car)
    return root


@each_detector
def test_ended_by_a_signal_and_resumed_gives_the_weights_of_an_uninterrupted_training(
    recipe: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_loop, "CURVE_STEPS", 2)
    files = cache_scenes(tmp_path / "scenes", ["0", "1"], _scene)
    whole: list[CurvePoint] = []
    straight = train_on_scenes(tmp_path / "straight", recipe, files, report=whole.extend)
    curve: list[CurvePoint] = []
    advance = detector_loop._train_step

    def advance_and_be_ended(run: Any, step: int, *batch: Any) -> dict[str, float]:
        if step == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return advance(run, step, *batch)

    before = signal.getsignal(signal.SIGTERM)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(detector_loop, "_train_step", advance_and_be_ended)
        train_on_scenes(tmp_path / "cut", recipe, files, report=curve.extend)
    assert signal.getsignal(signal.SIGTERM) is before
    state = read_checkpoint(tmp_path / "cut" / "checkpoint.pt")
    assert state["steps_done"] == 3
    resumed = train_on_scenes(tmp_path / "cut", recipe, files, report=curve.extend)
    for name, tensor in straight.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name
    assert curve == whole and [step for step, _ in curve] == [2, 4, 6, 8, 9], "each the mean of the steps since"
    assert {"class", "box", "positives", "learning_rate"} <= curve[-1][1].keys()


@pytest.mark.parametrize("rate", [1e8, 1e3], ids=["the loss is NaN", "weights are beyond any network's"])
def test_a_training_that_diverges_ends_there_and_leaves_the_weights_that_are_there(rate: float, tmp_path: Path) -> None:
    weights = tmp_path / "weights.safetensors"
    weights.write_bytes(b"those before")
    recipe = dataclasses.replace(TINY, peak_rate=rate)
    with pytest.raises(InputError, match="not finite") as caught:
        train_detector(tmp_path / "out", recipe, weights, KittiScenes(_kitti(tmp_path)))
    assert "smaller recipe.peak_rate=" in caught.value.remedy
    assert weights.read_bytes() == b"those before"


@pytest.mark.parametrize("rate", [TINY.peak_rate, 1e30])  # the second ends in an error
@pytest.mark.parametrize("flushed", [False, True])
def test_subnormal_numbers_are_after_a_training_as_before(flushed: bool, rate: float, tmp_path: Path) -> None:
    recipe = dataclasses.replace(TINY, steps=2, mesh_only_steps=2, settle_steps=1, peak_rate=rate)
    torch.set_flush_denormal(flushed)
    with contextlib.suppress(InputError):
        train_detector(tmp_path / "out", recipe, scenes=KittiScenes(_kitti(tmp_path)))
    assert bool(torch.tensor([1e-310], dtype=torch.float64) * 1.0 > 0.0) is not flushed


def test_a_folder_of_other_scenes_or_another_start_is_refused(tmp_path: Path) -> None:
    files = cache_scenes(tmp_path / "scenes", ["0"], _scene)
    train_on_scenes(tmp_path / "out", TINY, files, stop_after=1, data="kitti-1")
    with pytest.raises(InputError, match="another set of scenes, or from other weights"):
        train_on_scenes(tmp_path / "out", TINY, files, data="kitti-2")


def test_a_folder_of_another_recipe_is_refused_before_scenes_are_made(tmp_path: Path) -> None:
    files = cache_scenes(tmp_path / "scenes", ["0"], _scene)
    train_on_scenes(tmp_path / "out", TINY, files, stop_after=1)
    changed = dataclasses.replace(
        TINY, steps=TINY.steps + 1, augmentation=dataclasses.replace(TINY.augmentation, flip=0.25)
    )
    with pytest.raises(InputError, match=rf"another recipe than recipe\.steps={changed.steps}, recipe\.flip=0\.25\. "):
        train_detector(tmp_path / "out", changed)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["checkpoint.pt"]


def test_a_training_without_a_step_computes_the_statistics_and_states_its_facts(tmp_path: Path) -> None:
    recipe = dataclasses.replace(TINY, steps=0, mesh_only_steps=0, settle_steps=0)
    scenes, weights = KittiScenes(_kitti(tmp_path)), tmp_path / "out" / "pointpillars.safetensors"
    train_detector(tmp_path / "out", recipe, scenes=scenes)
    before = weights.read_bytes()
    facts = json.loads(weights.with_suffix(".json").read_text())
    assert (facts["steps"], facts["curve"]) == (0, [])
    found = load_file(weights)
    fresh = recipe.new_network().state_dict()
    assert not torch.equal(found["pillar_net.norm.running_var"], fresh["pillar_net.norm.running_var"])
    train_detector(tmp_path / "out", recipe, scenes=scenes)
    assert weights.read_bytes() == before


@each_detector
def test_weights_of_real_frames_go_to_the_given_folder_alone(
    recipe: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(RECIPES, recipe.detector, recipe)
    monkeypatch.setattr(command, "WEIGHTS_FOLDER", tmp_path / "shipped")
    out = tmp_path / "out"
    options = command.TrainOptions(out, threads=1, device="cpu", scenes=KittiScenes(_kitti(tmp_path)), steps=2)
    weights = command.train(recipe.detector, options)
    assert weights == out / f"{recipe.detector}.safetensors"
    assert load_file(weights).keys() == recipe.new_network().state_dict().keys()
    assert not (tmp_path / "shipped").exists()
    facts = json.loads(weights.with_suffix(".json").read_text())
    assert facts["scenes"] == {"dataset": "kitti", "count": 2, "names": ["000003", "000008"]}
    assert "sedan" in facts["vehicles"]["seen"]["body_types"]
    assert "roof_box" in facts["vehicles"]["held_out"]["attributes"]
    assert (facts["recipe"]["steps"], facts["recipe"]["settle_steps"], facts["steps"]) == (2, 1, 3)
    assert facts["recipe"]["seed"] == 0
    assert [point["step"] for point in facts["curve"]] == [2, 3] and facts["curve"][0]["class"] > 0
    assert facts["compute"]["device"] == "cpu" and facts["training_seconds"] >= 0
    assert facts["compute"]["steps_by_device"] == {"cpu": facts["steps"]}
    assert facts["versions"]["torch"] == torch.__version__
    state = torch.load(out / "checkpoint.pt", weights_only=True)
    del state["steps_by_device"]  # like a program that does not count them
    torch.save(state, out / "checkpoint.pt")
    assert command.train(recipe.detector, options) == weights


def test_only_the_shipped_recipe_writes_the_shipped_weights(tmp_path: Path) -> None:
    assert command.TrainOptions(tmp_path, threads=3, device="cpu").shipped
    kitti = KittiScenes(_kitti(tmp_path))
    for other in ({"scenes": kitti}, {"count": 3}, {"steps": 3}, {"inserted": 0}, {"start_from": "shipped"}):
        assert not command.TrainOptions(tmp_path, **other).shipped
    with pytest.raises(InputError, match="not on scenes"):
        command.train("sdf", command.TrainOptions(tmp_path, scenes=kitti))


def test_frames_of_ones_own_are_trained_on_by_the_words_that_evaluate_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frames of the split alone, with the ground at the given height."""
    monkeypatch.setitem(RECIPES, "pointpillars", TINY)
    monkeypatch.setattr(command, "WEIGHTS_FOLDER", tmp_path / "shipped")
    root, out = tmp_path / "frames", tmp_path / "out"
    for part in ("points", "labels", "ImageSets"):
        (root / part).mkdir(parents=True)
    for name in ("a", "b"):
        np.save(root / "points" / f"{name}.npy", _cloud())
        (root / "labels" / f"{name}.txt").write_text(f"{' '.join(map(str, BOX))} Car\n")
    (root / "ImageSets" / "train.txt").write_text("b\n")
    words = ["model=pointpillars", "scenes=openpcdet", f"root={root}", "split=train", "ground_z_m=-1.7", f"out={out}"]
    assert main(["train", *words, "device=cpu", "threads=1", "mlflow=none"]) == 0
    facts = json.loads((out / "pointpillars.json").read_text())
    assert facts["scenes"] == {"dataset": "openpcdet", "count": 1, "names": ["b"]}
    (file,) = out.glob("scenes-*/*.npz")
    np.testing.assert_allclose(load_cached(file).boxes[0, 2], BOX[2] + 1.7, atol=1e-6)
    assert not (tmp_path / "shipped").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["model=sst", "scenes=moon"], "scenes='moon' is unknown. One of: street, kitti, openpcdet"),
        (["model=sst", "scenes=waymo", "root=x"], "One of: street, kitti, openpcdet"),
        (["model=sst", "scenes=kitti"], "Give root=PATH, the folder that holds KITTI's training/"),
        (["model=sst", "scenes=kitti", "root=x", "split=val"], "split= means nothing for scenes=kitti"),
        (["model=sst", "root=x"], "root= means nothing for scenes=street"),
        (["model=sdf", "scenes=kitti", "root=x"], "scenes= is for detectors"),
        (["model=sst", "finetune=OUT", "scenes=openpcdet"], "scenes= means nothing with finetune="),
    ],
)
def test_scenes_that_cannot_be_trained_on_are_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *words, "mlflow=none"]) == 2
    captured = capsys.readouterr()
    assert message in captured.err and len(captured.err.strip().splitlines()) == 1


def test_words_of_a_recipe_reach_it_and_keep_the_shipped_weights(tmp_path: Path) -> None:
    fields = _recipe_words(["recipe.pasted=0", "recipe.peak_rate=2e-4"])
    options = _options({"model": "centerpoint", "out": str(tmp_path)}, fields)
    recipe = command.detector_recipe("centerpoint", options)
    assert (recipe.augmentation.pasted, recipe.peak_rate, recipe.heads) == (0, 2e-4, "centres")
    assert not options.shipped
    with pytest.raises(InputError, match=r"recipe\.sclae is unknown"):
        command.train("centerpoint", _options({"model": "centerpoint", "out": str(tmp_path)}, {"sclae": "1,1"}))
    with pytest.raises(InputError, match="given twice"):
        _recipe_words(["recipe.pasted=0", "recipe.pasted=1"])


def test_adapting_weights_takes_a_fifth_of_the_rate(tmp_path: Path) -> None:
    fresh = command.detector_recipe("sst", command.TrainOptions(tmp_path))
    adapting = command.detector_recipe("sst", command.TrainOptions(tmp_path, start_from="shipped"))
    assert fresh == RECIPES["sst"]
    assert adapting == dataclasses.replace(fresh, peak_rate=0.2 * fresh.peak_rate)


def test_a_training_may_start_from_nothing(tmp_path: Path) -> None:
    for name, recipe in RECIPES.items():
        own = command.detector_recipe(name, command.TrainOptions(tmp_path, start_from="random"))
        assert start_state(own, None) is None and own.peak_rate == recipe.peak_rate
    with pytest.raises(InputError, match="steps='0'"):
        _options({"model": "sst", "out": str(tmp_path), "steps": "0", "start_from": "random"})


def test_scenes_without_a_vehicle_are_refused(tmp_path: Path) -> None:
    root = _kitti(tmp_path)
    for file in (root / "training" / "label_2").glob("*.txt"):
        file.write_text("")
    with pytest.raises(InputError, match="no scene has a labelled vehicle"):
        train_detector(tmp_path / "out", TINY, scenes=KittiScenes(root))


def test_frames_that_have_changed_since_are_not_taken_from_the_cache(tmp_path: Path) -> None:
    root, out = _kitti(tmp_path), tmp_path / "out"
    before = scene_files(out, KittiScenes(root))
    assert scene_files(out, KittiScenes(root)) == before
    train_detector(out, TINY, scenes=KittiScenes(root))
    label = root / "training" / "label_2" / f"{before[0].stem}.txt"
    label.write_text(label.read_text().replace("8.00 -1.570796", "9.50 -1.570796"))
    after = scene_files(out, KittiScenes(root))
    assert load_cached(before[0]).boxes[0, 0] == 8.0 and load_cached(after[0]).boxes[0, 0] == 9.5
    with pytest.raises(InputError, match="another set of scenes"):
        train_detector(out, TINY, scenes=KittiScenes(root))


def test_only_the_labelled_sector_is_trained_on() -> None:
    """A car inside keeps points beyond the edge, a car outside loses those within it, and the rest is cut."""
    edge = np.tan(0.6) * 10.0
    inside, outside = (10.0, edge - 0.5, 0.8, 4.0, 1.8, 1.6, 0.0), (10.0, edge + 0.5, 0.8, 4.0, 1.8, 1.6, 0.0)
    points = np.array([[10, 0, 0], [10, edge - 0.2, 0.8], [10, edge + 0.2, 0.8], [-10, 0, 0], [1, 9, 0]], np.float32)

    def cut(box: tuple[float, ...]) -> TrainingScene:
        labels = Labels(np.array([box]), ("vehicle",), np.array([2], np.int32))
        return from_scene(Scene("a", "toy", points, np.zeros_like(points), 0.0, labels), (0.0, 0.6))

    assert cut(inside).points.tolist() == points[:3].tolist() and len(cut(inside).boxes) == 1
    assert cut(outside).points.tolist() == points[:1].tolist() and len(cut(outside).boxes) == 0
    boxes = np.array([inside, outside], np.float32)
    last = cut_scene(points, boxes[1:], 1.7, (0.0, 0.6), keep_last_box=True)
    assert last.points.tolist() == points[:3].tolist() and last.boxes.tolist() == boxes[1:].tolist()
    assert cut_scene(points, boxes[::-1], 1.7, (0.0, 0.6), keep_last_box=True).boxes.tolist() == boxes[:1].tolist()


def test_fewer_steps_keep_the_share_without_insertions() -> None:
    short = scaled_to_steps(RECIPES["pointpillars"], 700)
    recipe = RECIPES["pointpillars"]
    names = ("steps", "mesh_only_steps", "settle_steps")
    for name in names:
        assert getattr(short, name) == pytest.approx(getattr(recipe, name) * 700 / recipe.steps, abs=0.51)
    assert dataclasses.replace(short, **{name: getattr(recipe, name) for name in names}) == recipe


def test_a_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="unknown device"):
        choose_compute("tpu")
    if not torch.cuda.is_available():
        assert choose_compute("auto").device.type == "cpu"
        with pytest.raises(InputError, match="no CUDA"):
            choose_compute("cuda")


def test_points_are_encoded_in_float32_under_autocast() -> None:
    cloud = torch.from_numpy(_cloud() + np.array((0, 0, 1.73), np.float32))
    pillars, tokens = PointPillarsNet(PILLARS), SstNet(TOKENS)
    with torch.no_grad():
        exact = pillars.canvas([cloud], [WINDOW]), tokens.batch_features([cloud], [WINDOW])[1]
        with torch.autocast("cpu", torch.bfloat16):
            mixed = pillars.canvas([cloud], [WINDOW]), tokens.batch_features([cloud], [WINDOW])[1]
            logits = [net([cloud], [WINDOW]) for net in (pillars, tokens)]
    assert all(torch.equal(a, b) for a, b in zip(exact, mixed, strict=True))
    assert all(torch.isfinite(values.float()).all() for values in logits)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@each_detector
def test_training_on_cuda_follows_the_cpu(recipe: Recipe, tmp_path: Path) -> None:
    files = cache_scenes(tmp_path / "scenes", ["0", "1"], _scene)
    exact = dataclasses.replace(recipe, bfloat16=False, steps=2, mesh_only_steps=2)
    curves: dict[str, list[CurvePoint]] = {"cpu": [], "cuda": []}
    for device, curve in curves.items():
        compute = Compute(torch.device(device))
        train_on_scenes(tmp_path / device, exact, files, compute=compute, report=curve.extend)
    assert curves["cuda"][-1][1] == pytest.approx(curves["cpu"][-1][1], rel=1e-3)


def test_steps_0_settles_weights_that_are_there_and_nothing_else(tmp_path: Path) -> None:
    """There is nothing to settle without a start: random weights, and heads on top of them."""
    words = {"model": "pointpillars", "out": str(tmp_path), "steps": "0"}
    options = _options({**words, "start_from": "shipped"})
    recipe = command.detector_recipe("pointpillars", options)
    assert (recipe.steps, recipe.mesh_only_steps, recipe.all_steps) == (0, 0, RECIPES["pointpillars"].settle_steps)
    assert not options.shipped, "what ships is not written over"
    with pytest.raises(InputError, match="steps='0' is not a whole number"):
        _options(words)
