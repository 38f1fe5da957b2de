"""Recipes: words change fields, unusable values are refused, warm starts draw the same boxes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch
from random_networks import random_net, random_scene
from safetensors.torch import load_file, save_file

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models import weights as weights_module
from shift3d.detectors.models.anchor_heads import AnchorSpec
from shift3d.detectors.models.pillar_detectors import PILLAR_NETWORKS, PointPillarsNet
from shift3d.detectors.names import DETECTOR_NAMES
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError
from shift3d.training.detector import warm_start
from shift3d.training.detector.loop import recompute_statistics
from shift3d.training.detector.objective import OBJECTIVES
from shift3d.training.detector.recipe import Augmentation, Recipe
from shift3d.training.detector.recipes import RECIPES, changed
from shift3d.training.detector.train import export_weights
from shift3d.training.detector.warm_start import start_state, with_anchor_size

WINDOW = BevWindow(200, 200, 64, 64, 200, 200, 64, 64)


@pytest.mark.parametrize("name", RECIPES)
def test_every_shipped_recipe_can_be_trained_by_and_is_of_its_name(name: str) -> None:
    assert RECIPES[name].validate().detector == name


def test_every_detector_has_a_network_a_recipe_and_settings_and_every_kind_of_heads_an_objective() -> None:
    settings = {file.stem for file in (Path(__file__).parents[3] / "conf" / "detector").glob("*.yaml")}
    assert set(DETECTOR_NAMES) == set(weights_module.NETWORKS) == set(RECIPES) == settings & set(RECIPES)
    assert set(OBJECTIVES) == set(PILLAR_NETWORKS)


def test_words_change_fields_of_the_recipe_and_of_its_augmentation() -> None:
    words = {"peak_rate": "1e-4", "pasted": "0", "scale": "1,1", "bfloat16": "false", "range_bins_m": "0,20,40,75"}
    found = changed(Recipe(), words)
    expected = dataclasses.replace(
        Recipe(),
        peak_rate=1e-4,
        bfloat16=False,
        augmentation=Augmentation(pasted=0, scale=(1.0, 1.0), range_bins_m=(0.0, 20.0, 40.0, 75.0)),
    )
    assert found == expected and changed(Recipe(), {}) == Recipe()


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("sclae", "1,1", "recipe.sclae is unknown"),
        ("sclae", "1,1", r"Did you mean recipe\.scale="),
        ("network", "1", "recipe.network is unknown"),
        ("pasted", "many", "recipe.pasted='many'"),
        ("scale", "1.1,0.9", "The range is empty"),
        ("scale", "1.1", "The range is empty"),
        ("object_scale", "0,1", "above 0"),
        ("object_stretch", "1.2,0.8", "The range is empty"),
        ("object_stretch", "0.8,1.2,1.1,1.0,1,1", "The range is empty"),
        ("object_stretch", "0.8,1.2,0.9,1.1", "one for each axis"),
        ("object_stretch", "1,1,0,1,1,1", "above 0"),
        ("range_bins_m", "30", "rising edges"),
        ("range_bins_m", "0,50,30", "rising edges"),
        ("kept_points", "nan,1", "The range is empty"),
        ("pasted_range", "0.5,1", "thinned"),
        ("flip", "1.5", "share"),
        ("batch", "0", "1 or more"),
        ("peak_rate", "0", "above 0"),
        ("anchor_size_m", "4.4,1.8,0", "above 0"),
        ("code_weights", "1,1", "seven"),
        ("anchor_size_m", "4.4,1.8", "length,width,height"),
        ("code_weights", "nan,1,1,1,1,1,1", "0 or more"),
        ("jitter_m", "inf", "0 or more"),
        ("shift_m", "inf", "0 or more"),
        ("crop_cells", "512", "468"),
        ("mesh_only_steps", "20001", "no step draws an inserted scene"),
        ("crop_cells", "90", "multiple of 4"),
        ("settle_steps", "-1", "0 or more"),
    ],
)
def test_what_cannot_be_trained_by_is_refused_in_one_line(field: str, value: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        changed(Recipe(), {field: value})
    assert "\n" not in str(error.value) and field in str(error.value)


def test_heads_that_a_network_does_not_have_are_refused() -> None:
    with pytest.raises(InputError, match="heads=centres"):
        dataclasses.replace(RECIPES["sst"], heads="centres").validate()


def test_anchors_of_another_size_draw_the_same_boxes() -> None:
    net = random_net("pointpillars")
    torch.nn.init.normal_(net.heads.boxes.weight, std=0.05)
    torch.nn.init.normal_(net.heads.boxes.bias, std=0.2)
    other = PointPillarsNet(net.spec, anchors=AnchorSpec((3.0, 1.0, 1.0)))
    other.load_state_dict(with_anchor_size(net.state_dict(), (4.4, 1.8, 1.55)))
    one, two = (TrainedDetector(each.eval()).proposals(random_scene(), WINDOW) for each in (net, other))
    assert other.heads.anchors.size_m == pytest.approx((4.4, 1.8, 1.55))
    assert torch.equal(one.logits, two.logits)
    assert float(one.boxes[:, 3].std()) > 0.05
    assert torch.allclose(one.boxes, two.boxes, atol=2e-4, rtol=1e-4)


def test_a_file_without_an_anchor_size_has_the_published_one(tmp_path: Path) -> None:
    net = random_net("pointpillars")
    state = {name: tensor.contiguous() for name, tensor in net.state_dict().items() if "anchor" not in name}
    save_file(state, tmp_path / "old.safetensors")
    loaded = weights_module.load_weights(
        PointPillarsNet(net.spec, anchors=AnchorSpec((1.0, 1.0, 1.0))), tmp_path / "old.safetensors"
    )
    assert loaded.heads.anchors.size_m == pytest.approx((4.73, 2.08, 1.77))


def test_exported_weights_are_half_as_large_and_score_the_same(tmp_path: Path) -> None:
    net = random_net("pointpillars")
    net.heads.classes.bias.data[0] = 1e5  # beyond half precision, like some batch variances
    file = tmp_path / "pointpillars.safetensors"
    export_weights(net, file, Recipe())
    loaded = weights_module.load_weights(PointPillarsNet(net.spec, anchors=net.heads.anchors), file)
    stored, whole = load_file(file), net.state_dict()
    assert sum(tensor.nbytes for tensor in stored.values()) < 0.6 * sum(tensor.nbytes for tensor in whole.values())
    one, two = (TrainedDetector(each.eval()).proposals(random_scene(), WINDOW) for each in (net, loaded))
    assert torch.allclose(one.logits, two.logits, rtol=1e-3, atol=1e-2)


def test_a_backbone_from_another_detector_comes_without_its_heads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pillars = random_net("pointpillars")
    monkeypatch.setitem(weights_module.NETWORKS, "pointpillars", lambda: PointPillarsNet(pillars.spec))
    monkeypatch.setattr(warm_start, "WEIGHTS_FOLDER", tmp_path)
    export_weights(pillars, tmp_path / "pointpillars.safetensors", Recipe())
    recipe = Recipe(network=pillars.spec, heads="centres", backbone_from="pointpillars")
    state = start_state(recipe, None)
    assert state is not None
    net = recipe.new_network()
    net.load_state_dict(dict(state))
    theirs = {name: tensor for name, tensor in pillars.state_dict().items() if not name.startswith("heads.")}
    assert all(torch.allclose(state[name], tensor, rtol=2.0**-11, atol=2.0**-24) for name, tensor in theirs.items())
    assert len(net.heads.boxes.bias) == 8
    with pytest.raises(InputError, match="does not exist"):
        start_state(dataclasses.replace(recipe, backbone_from="sst"), None)


@pytest.mark.parametrize("name", ["pointpillars", "sst"])
def test_recomputed_statistics_are_those_that_inference_meets(name: str) -> None:
    """Over the same crops, every norm's input at inference has the mean and variance that the norm stores."""
    net = random_net(name).double()
    clouds = [random_scene(6000, seed).double() for seed in range(6)]
    before = {key: tensor.clone() for key, tensor in net.state_dict().items()}
    recompute_statistics(net, clouds, [WINDOW] * 6)
    assert not net.training
    seen: dict[str, torch.Tensor] = {}
    norms = {
        key: module
        for key, module in net.named_modules()
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d)
    }
    for key, module in norms.items():
        module.register_forward_hook(lambda _, inputs, __, key=key: seen.update({key: inputs[0]}))
    with torch.no_grad():
        net.features(clouds, [WINDOW] * 6)
    for key, module in norms.items():
        values = seen[key].transpose(0, 1).flatten(1)
        # To n / (n - 1): a norm divides by one variance in training and stores the other, of some thousand values.
        assert ((module.running_mean - values.mean(dim=1)).abs() < 0.01 * values.std(dim=1)).all(), key
        assert torch.allclose(module.running_var, values.var(dim=1), rtol=0.02, atol=1e-6), key
        assert module.momentum == 0.01
    kept = {key for key, tensor in net.state_dict().items() if torch.equal(tensor, before[key])}
    assert kept == {key for key in before if "running" not in key and "num_batches" not in key}
