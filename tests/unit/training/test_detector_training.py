"""Targets, losses and the training loop of the detector, on handmade scenes."""

from dataclasses import fields, replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
import torch

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID
from shift3d.detectors.models.anchor_heads import WAYMO_ANCHORS, anchor_boxes, decode_boxes
from shift3d.detectors.models.backbone import BackboneSpec
from shift3d.detectors.models.sst import SST_SMALL_SPEC
from shift3d.errors import InputError
from shift3d.geometry.boxes import points_in_boxes
from shift3d.store.user_cache import program_digest, source_digest
from shift3d.training.detector.anchor_objective import (
    IGNORED,
    NEGATIVE,
    POSITIVE,
    AnchorObjective,
    assign_anchors,
    focal_loss,
    nearest_bev_iou,
    sine_code_difference,
)
from shift3d.training.detector.batches import BatchMaker, batches
from shift3d.training.detector.crop_sampling import RandomCrops
from shift3d.training.detector.crops import random_crop
from shift3d.training.detector.loop import train_on_scenes
from shift3d.training.detector.objective import objective_of
from shift3d.training.detector.pasting import VehicleDatabase
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector.recipes import one_cycle, scaled_to_steps
from shift3d.training.detector.train import inserted_scene_files
from shift3d.training.detector_scenes import TrainingScene, cache_scenes, load_cached
from shift3d.training.progress import downsampled

WINDOW = BevWindow(214, 214, 40, 40, 214, 214, 40, 40)
ANCHORS = anchor_boxes(WAYMO_ANCHORS, WAYMO_GRID, WINDOW)
TINY = Recipe(
    steps=6,
    settle_steps=3,
    mesh_only_steps=3,
    statistics_crops=3,
    crop_cells=32,
    batch=2,
    network=BackboneSpec(in_channels=4, channels=(4, 4, 4), up_channels=4),
)


def _scene(name: str) -> TrainingScene:
    """Return a flat ground with boxes whose faces have points."""
    rng = np.random.default_rng(int(name))
    ground = rng.uniform((-40, -40, 0), (40, 40, 0.02), (4000, 3))
    clouds, boxes = [ground], []
    for _ in range(6):
        box = np.array([*rng.uniform(-30, 30, 2), 0.8, 4.5, 1.9, 1.6, rng.uniform(-pi, pi)])
        local = rng.uniform(-0.5, 0.5, (200, 3))
        faces = rng.integers(0, 3, 200)
        local[np.arange(200), faces] = np.sign(local[np.arange(200), faces]) * 0.499
        local *= box[3:6]
        cos, sin = np.cos(box[6]), np.sin(box[6])
        local[:, :2] = local[:, :2] @ np.array([[cos, sin], [-sin, cos]])
        clouds.append(local + box[:3])
        boxes.append(box)
    return TrainingScene(np.concatenate(clouds).astype(np.float32), np.array(boxes, dtype=np.float32), 1.73)


def test_nearest_iou_of_snapped_boxes() -> None:
    box = torch.tensor([[0.0, 0, 0, 4, 2, 1, 0]])
    others = torch.tensor([[2.0, 0, 0, 4, 2, 1, pi + 0.1], [0, 0, 0, 4, 2, 1, pi / 2 - 0.1], [0, 9, 0, 4, 2, 1, 0]])
    assert nearest_bev_iou(box, others)[0].tolist() == pytest.approx([4 / 12, 4 / 12, 0.0])


def test_targets_decode_to_the_vehicle() -> None:
    vehicle = torch.tensor([[0.3, -0.7, 0.8, 4.4, 1.8, 1.5, 2.9]])
    targets = assign_anchors(ANCHORS, vehicle, torch.tensor([True]))
    assert targets.positives.numel() > 4
    directions = torch.nn.functional.one_hot(targets.directions, 2).float()
    decoded = decode_boxes(targets.codes, ANCHORS[targets.positives], directions)
    assert torch.allclose(decoded, vehicle.expand_as(decoded), atol=1e-4)
    overlap = nearest_bev_iou(ANCHORS, vehicle)[:, 0]
    assert (targets.labels[overlap >= 0.55] == POSITIVE).all()
    assert (targets.labels[(overlap >= 0.40) & (overlap < 0.55)] == IGNORED).all()
    assert (targets.labels[overlap < 0.40] == NEGATIVE).all()


def test_a_vehicle_unlike_any_anchor_still_trains_its_best_one() -> None:
    truck = torch.tensor([[0.3, -0.7, 1.5, 11.0, 2.6, 3.5, 0.0]])
    targets = assign_anchors(ANCHORS, truck, torch.tensor([True]))
    best = nearest_bev_iou(ANCHORS, truck)[:, 0]
    assert best.max() < 0.55
    assert (targets.labels[best == best.max()] == POSITIVE).all()


def test_vehicles_with_few_points_only_ignore() -> None:
    vehicle = torch.tensor([[0.3, -0.7, 0.8, 4.4, 1.8, 1.5, 0.1]])
    targets = assign_anchors(ANCHORS, vehicle, torch.tensor([False]))
    assert targets.positives.numel() == 0
    assert (targets.labels == IGNORED).any() and (targets.labels == NEGATIVE).any()


def test_without_vehicles_every_anchor_is_background_to_the_edges_of_the_crop() -> None:
    targets = assign_anchors(ANCHORS, torch.zeros(0, 7), torch.zeros(0, dtype=torch.bool))
    assert (targets.labels == NEGATIVE).all()
    assert targets.codes.shape == (0, 7)


def test_focal_loss_at_zero_and_at_the_extremes() -> None:
    logits = torch.tensor([0.0, 100.0, -100.0, 0.0], requires_grad=True)
    is_positive = torch.tensor([True, False, True, False])
    loss = focal_loss(logits, is_positive)
    assert loss[0].item() == pytest.approx(0.25 * 0.25 * np.log(2), rel=1e-5)
    assert loss[1].item() == pytest.approx(0.75 * 100.0, rel=1e-5)
    assert loss[2].item() == pytest.approx(0.25 * 100.0, rel=1e-5)
    assert loss[3].item() == pytest.approx(0.75 * 0.25 * np.log(2), rel=1e-5)
    loss.sum().backward()
    assert logits.grad is not None and torch.isfinite(logits.grad).all()
    assert logits.grad[1] > 0 > logits.grad[2]


def test_half_turns_cost_nothing() -> None:
    codes = torch.zeros(2, 7)
    codes[:, 6] = torch.tensor([0.3, 0.3 + pi])
    wanted = torch.zeros(2, 7)
    wanted[:, 6] = 0.3
    assert sine_code_difference(codes, wanted).abs().max() < 1e-6


def test_loss_without_positives_is_finite() -> None:
    targets = assign_anchors(ANCHORS, torch.zeros(0, 7), torch.zeros(0, dtype=torch.bool))
    count = len(ANCHORS)
    logits = torch.full((count,), 100.0, requires_grad=True)
    parts = AnchorObjective(TINY).loss(logits, torch.zeros(0, 18), targets)
    assert torch.isfinite(parts["class"]) and parts["box"] == parts["direction"] == 0.0


def test_a_crop_moves_boxes_with_their_points() -> None:
    scene = _scene("3")
    before = points_in_boxes(scene.points, scene.boxes, 0.05).sum(axis=1)
    seen = 0
    for seed in range(20):
        crop = random_crop(scene, WAYMO_GRID, Recipe(crop_cells=96), np.random.default_rng(seed))
        same = random_crop(scene, WAYMO_GRID, Recipe(crop_cells=96), np.random.default_rng(seed))
        assert np.array_equal(crop.points, same.points) and np.array_equal(crop.boxes, same.boxes)
        inside = points_in_boxes(crop.points, crop.boxes, 0.25).sum(axis=1)
        assert len(crop.boxes) <= len(before)
        x0, y0 = (-74.88 + 0.32 * start for start in (crop.window.x0, crop.window.y0))
        reach = 96 * 0.32
        in_window = (abs(crop.boxes[:, 0] - x0 - reach / 2) < reach / 2) & (
            abs(crop.boxes[:, 1] - y0 - reach / 2) < reach / 2
        )
        seen += int(in_window.sum())
        # Vehicles in the crop keep a good part of their 200 points, whatever was dropped.
        assert np.median(inside[in_window]) > 20 if in_window.any() else True
    assert seen > 20


def test_one_cycle_rises_and_falls() -> None:
    recipe = Recipe(steps=100, warm_up_share=0.3, peak_rate=1e-3)
    rates = [one_cycle(step, recipe)[0] for step in range(100)]
    assert rates[0] == pytest.approx(1e-4) and max(rates) == pytest.approx(1e-3) and rates[-1] < 1e-5
    assert int(np.argmax(rates)) == 30
    last = [one_cycle(step, recipe)[0] for step in range(100, recipe.all_steps)]
    assert last[0] == recipe.settle_rate and last == sorted(last, reverse=True) and last[-1] < 1e-7


def test_a_curve_is_told_by_the_means_of_its_stretches() -> None:
    curve = [(25 * index, {"box": float(index % 2)}) for index in range(1, 9)]
    assert downsampled(curve, 4) == [(50, {"box": 0.5}), (100, {"box": 0.5}), (150, {"box": 0.5}), (200, {"box": 0.5})]
    assert (
        downsampled(curve, 3)[-1] == (200, {"box": 0.5})
        and downsampled(curve[:2], 30) == curve[:2]
        and downsampled([], 3) == []
    )


def test_a_resumed_training_gives_the_same_weights(tmp_path: Path) -> None:
    mesh = cache_scenes(tmp_path / "mesh", ["0", "1"], _scene)
    inserted = cache_scenes(tmp_path / "inserted", ["2"], _scene)
    straight = train_on_scenes(tmp_path / "a", TINY, mesh, inserted)
    train_on_scenes(tmp_path / "b", TINY, mesh, inserted, checkpoint_every=2, stop_after=4)
    train_on_scenes(tmp_path / "b", TINY, mesh, inserted, stop_after=TINY.steps + 1)
    resumed = train_on_scenes(tmp_path / "b", TINY, mesh, inserted)
    start = train_on_scenes(tmp_path / "c", TINY, mesh, inserted, stop_after=0)
    for name, tensor in straight.state_dict().items():
        assert torch.equal(tensor, resumed.state_dict()[name]), name
    assert any(not torch.equal(a, b) for a, b in zip(straight.parameters(), start.parameters(), strict=True))
    with pytest.raises(InputError, match="another recipe"):
        train_on_scenes(tmp_path / "b", replace(TINY, steps=7), mesh, inserted)


def test_the_last_steps_settle_the_heads_on_statistics_of_inference(tmp_path: Path) -> None:
    """The class head settles too: the attacked network is the trained one. Encoder and backbone keep their weights."""
    mesh = cache_scenes(tmp_path / "mesh", ["0", "1"], _scene)
    start = train_on_scenes(tmp_path / "a", TINY, mesh, stop_after=TINY.steps).state_dict()
    tuned = train_on_scenes(tmp_path / "a", TINY, mesh)
    assert all(part.requires_grad for part in tuned.parameters())
    changed = {name for name, tensor in tuned.state_dict().items() if not torch.equal(tensor, start[name])}
    heads = {f"heads.{head}.{part}" for head in ("classes", "boxes", "directions") for part in ("weight", "bias")}
    statistics = {name for name in start if "running" in name or "num_batches" in name}
    assert changed == heads | statistics
    alone = scaled_to_steps(TINY, 0)
    again = train_on_scenes(tmp_path / "b", alone, mesh, start=start)
    assert alone.all_steps == TINY.settle_steps
    assert not torch.equal(again.heads.classes.weight, start["heads.classes.weight"])
    assert not torch.equal(again.heads.boxes.bias, start["heads.boxes.bias"])


def test_processes_make_the_batches_of_a_thread(tmp_path: Path) -> None:
    """Beside a GPU, processes make the same crops, in the order of the steps."""
    files = cache_scenes(tmp_path, ["0", "1"], _scene)
    for recipe, workers in ((TINY, 1), (replace(TINY, heads="centres"), 2)):
        net = recipe.new_network()
        crops = RandomCrops(recipe, net.grid, files, [], VehicleDatabase.of(files, recipe.min_points))
        maker = BatchMaker(crops, objective_of(recipe), net)
        made, again = (list(batches(maker, range(3, 9), number)) for number in (0, workers))
        for (step, ours), (same_step, same) in zip(made, again, strict=True):
            assert step == same_step
            for example, other in zip(ours, same, strict=True):
                assert example.window == other.window and torch.equal(example.points, other.points)
                for part, like in ((example.pillars, other.pillars), (example.targets, other.targets)):
                    assert type(part) is type(like)
                    for item in fields(part):
                        assert torch.equal(getattr(part, item.name), getattr(like, item.name)), item.name


@pytest.mark.parametrize("recipe", [TINY, replace(TINY, heads="centres"), replace(TINY, network=SST_SMALL_SPEC)])
def test_examples_give_the_features_of_their_crops(recipe: Recipe, tmp_path: Path) -> None:
    """Points sorted by pillars, and several clouds side by side, give the features of each crop bit for bit."""
    files = cache_scenes(tmp_path, ["0", "1"], _scene)
    net = recipe.new_network().eval()
    crops = RandomCrops(recipe, net.grid, files, [], None)
    _, examples = BatchMaker(crops, objective_of(recipe), net).of(3)
    drawn = [crops.of(3, slot) for slot in range(recipe.batch)]
    clouds, windows = [torch.from_numpy(crop.points) for crop in drawn], [crop.window for crop in drawn]
    made = net.features([example.points for example in examples], windows, [example.pillars for example in examples])
    assert torch.equal(made, net.features(clouds, windows))


def test_a_step_that_cannot_be_made_ends_the_training(tmp_path: Path) -> None:
    files = cache_scenes(tmp_path, ["0"], lambda name: replace(_scene(name), points=_scene(name).points[:3]))
    net = TINY.new_network()
    maker = BatchMaker(RandomCrops(TINY, net.grid, files, [], None), objective_of(TINY), net)
    for workers in (0, 1):
        with pytest.raises(InputError, match="fewer than 10 points"):
            list(batches(maker, range(3), workers))


def test_processes_cache_and_collect_what_one_does(tmp_path: Path) -> None:
    files = cache_scenes(tmp_path / "made", ["0", "1", "2"], _scene)
    again = cache_scenes(tmp_path / "again", map(str, files), load_cached, workers=2)
    assert [file.read_bytes() for file in again] == [file.read_bytes() for file in files]
    one, two = (VehicleDatabase.of(files, TINY.min_points, workers) for workers in (1, 2))
    assert np.array_equal(one.boxes, two.boxes) and np.array_equal(one.range_m, two.range_m)
    assert len(one.points) == len(two.points) > 10 and all(map(np.array_equal, one.points, two.points))


def test_the_cache_is_written_once_and_read_back(tmp_path: Path) -> None:
    files = cache_scenes(tmp_path, ["5"], _scene)
    again = cache_scenes(tmp_path, ["5"], lambda name: pytest.fail("built twice"))
    assert files == again
    scene, read = _scene("5"), load_cached(files[0])
    assert np.array_equal(scene.points, read.points) and np.array_equal(scene.boxes, read.boxes)
    assert read.sensor_height_m == 1.73


def test_a_damaged_scene_of_the_cache_is_named(tmp_path: Path) -> None:
    (file,) = cache_scenes(tmp_path, ["5"], _scene)
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(InputError, match=r"5\.npz: .*Remove the file"):
        VehicleDatabase.of([file], TINY.min_points)


@pytest.mark.parametrize("part", ["/scenes/street/raycast.py", "/attack/objective.py", "/finetuning/tune.py"])
def test_scenes_of_another_program_are_built_again(part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache_scenes(tmp_path / "scenes", ["5"], lambda _: _scene("4"))  # like the file of an earlier program
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(part))
    monkeypatch.setattr("shift3d.store.user_cache.source_digest", source_digest.__wrapped__)
    monkeypatch.setattr("shift3d.training.detector_scenes.program_digest", program_digest.__wrapped__, raising=False)
    (again,) = cache_scenes(tmp_path / "scenes", ["5"], _scene)
    assert np.array_equal(load_cached(again).points, _scene("5").points)
    assert cache_scenes(tmp_path / "scenes", ["5"], lambda _: pytest.fail("built twice")) == [again]


def test_inserted_scenes_of_another_seed_or_number_of_scenes_are_not_taken_over(tmp_path: Path) -> None:
    base = cache_scenes(tmp_path / "mesh", ["0", "1"], _scene)
    recipe = replace(TINY, inserted_scenes=1)
    found = [
        inserted_scene_files(tmp_path, scenes, replace(recipe, seed=seed))[0]
        for scenes, seed in ((base, 0), (base, 1), (base[1:], 0), (base, 0))
    ]
    assert found[3] == found[0] and len({file.read_bytes() for file in found}) == 3
