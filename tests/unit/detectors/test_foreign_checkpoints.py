"""Foreign checkpoints, strictly: missing, surplus, misshapen entries and objects are refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from foreign_cases import CASES, Case

from shift3d.detectors.foreign.detector import foreign_layout, load_foreign
from shift3d.errors import InputError

PCD, MM = CASES["openpcdet-pointpillar"], CASES["mmdet3d-centerpoint"]
State = dict[str, torch.Tensor]


def load(case: Case, folder: Path, change: Callable[[State], Any] = lambda state: None, wrap: Any = None) -> Any:
    """Load a case's checkpoint after an in-place change of its state. wrap: state to the saved object."""
    config, weights = case.saved(folder)
    state = torch.load(weights, weights_only=True)[case.key]
    change(state)
    torch.save({case.key: state} if wrap is None else wrap(state), weights)
    return load_foreign(foreign_layout(case.name.split("-")[0], config, case.choices), weights)


def refused(case: Case, folder: Path, change: Callable[[State], Any], wrap: Any = None) -> str:
    with pytest.raises(InputError) as caught:
        load(case, folder, change, wrap)
    assert caught.value.remedy and str(folder / "model.pth") in caught.value.where and "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_every_tensor_counts(case: Case, tmp_path: Path) -> None:
    """A checkpoint without any one of the tensors, or with it in another shape, is refused."""
    config, weights = case.saved(tmp_path)
    layout = foreign_layout(case.name.split("-")[0], config, case.choices)
    whole = torch.load(weights, weights_only=True)[case.key]
    names = [name for name in whole if "num_batches" not in name and name != "global_step"]
    generator = np.random.default_rng(0)
    for name in generator.choice(names, 6, replace=False):
        torch.save({case.key: {key: value for key, value in whole.items() if key != name}}, weights)
        with pytest.raises(InputError, match=f"1 tensor missing: {name}"):
            load_foreign(layout, weights)
        torch.save({case.key: {**whole, name: whole[name].new_zeros(3, *whole[name].shape)}}, weights)
        with pytest.raises(InputError, match=f"1 tensor of another shape: {name} is \\(3, "):
            load_foreign(layout, weights)


def test_what_is_wrong_is_named_all_at_once(tmp_path: Path) -> None:
    def change(state: State) -> None:
        for name in [name for name in state if name.startswith("vfe")]:
            del state[name]
        state["dense_head.more.weight"] = torch.zeros(2)
        state["dense_head.conv_cls.bias"] = torch.zeros(7)

    printed = refused(PCD, tmp_path, change)
    assert (
        "5 tensors missing: vfe.pfn_layers.0.linear.weight, vfe.pfn_layers.0.norm.bias" in printed
        and ", ..." in printed
    )
    assert "1 tensor too many: dense_head.more.weight" in printed
    assert "dense_head.conv_cls.bias is (7,), the config asks for (18,)" in printed


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("backbone_3d.conv_input.0.weight", "sparse 3D backbone"),
        ("roi_head.reg_layers.0.weight", "second stage"),
        ("img_backbone.conv1.weight", "images"),
        ("dense_head.rpn_heads.0.conv_cls.weight", "AnchorHeadMulti"),
    ],
)
def test_another_model_is_told_by_its_names(name: str, says: str, tmp_path: Path) -> None:
    assert says in refused(PCD, tmp_path, lambda state: state.update({name: torch.zeros(1)}))


def test_the_other_codebase_is_told_by_its_names(tmp_path: Path) -> None:
    other = CASES["mmdet3d-pointpillars"].state()
    printed = refused(PCD, tmp_path, lambda state: (state.clear(), state.update(other)))
    assert "it looks like a pillar model of mmdetection3d" in printed


@pytest.mark.parametrize(
    ("value", "says"),
    [(float("nan"), "not finite"), (float("inf"), "not finite"), (1e20, "beyond")],
)
def test_values_that_no_training_leaves(value: float, says: str, tmp_path: Path) -> None:
    name = "backbone_2d.blocks.0.1.weight"
    printed = refused(PCD, tmp_path, lambda state: state[name].view(-1)[:1].fill_(value))
    assert name in printed and says in printed


@pytest.mark.parametrize("change", [torch.Tensor.to_sparse, lambda value: value.to("meta")], ids=["sparse", "meta"])
def test_a_tensor_without_dense_values(change: Callable[[torch.Tensor], torch.Tensor], tmp_path: Path) -> None:
    name = "backbone_2d.blocks.0.1.weight"
    printed = refused(PCD, tmp_path, lambda state: state.update({name: change(state[name])}))
    assert f"tensor {name} is" in printed and "dense" in printed


def test_eight_bit_weights_are_read_as_their_values(tmp_path: Path) -> None:
    name = "backbone_2d.blocks.0.1.weight"
    ones = load(PCD, tmp_path, lambda state: state[name].fill_(1.0)).proposals(torch.zeros(0, 3)).logits
    eight_bit = load(PCD, tmp_path, lambda state: state.update({name: state[name].fill_(1.0).to(torch.float8_e4m3fn)}))
    assert torch.equal(eight_bit.proposals(torch.zeros(0, 3)).logits, ones)


def test_a_negative_variance(tmp_path: Path) -> None:
    name = "pts_neck.deblocks.0.1.running_var"
    assert name in refused(MM, tmp_path, lambda state: state[name].fill_(-1.0))


def test_what_trainers_put_beside_the_tensors_is_left_alone(tmp_path: Path) -> None:
    numbers = {"best": np.float64(0.7), "seen": np.int64(5), "on": np.bool_(True)}
    optimiser = {"state": {0: {"step": 3, "exp_avg": torch.zeros(2)}}, "param_groups": [{"lr": 0.1}]}
    plain = load(PCD, tmp_path).proposals(torch.zeros(0, 3)).logits
    for wrap in (
        lambda state: {"model_state": state, "optimizer_state": optimiser, "accumulated_iter": 7, **numbers},
        lambda state: {f"module.{name}": value for name, value in state.items()},
        lambda state: {"state_dict": state, "meta": {"epoch": 3, **numbers}},
        lambda state: {"model_state": {k: v for k, v in state.items() if "num_batches" not in k}},
    ):
        assert torch.equal(load(PCD, tmp_path, wrap=wrap).proposals(torch.zeros(0, 3)).logits, plain)


class Trap:
    """An object that is not data."""

    def __reduce__(self) -> Any:
        return print, ("run",)


def test_objects_are_refused_and_never_made(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    printed = refused(PCD, tmp_path, lambda state: None, lambda state: {"model_state": state, "hook": Trap()})
    assert "model.state_dict()" in printed and "run" not in capsys.readouterr().out


@pytest.mark.parametrize("content", [[1, 2], {"epoch": 3}, {"model_state": {"a": 1}}])
def test_no_table_of_tensors(content: Any, tmp_path: Path) -> None:
    refused(PCD, tmp_path, lambda state: None, lambda state: content)


def test_a_file_that_is_none(tmp_path: Path) -> None:
    config, weights = PCD.saved(tmp_path)
    weights.write_bytes(weights.read_bytes()[:2000])
    layout = foreign_layout("openpcdet", config)
    with pytest.raises(InputError, match="no readable checkpoint"):
        load_foreign(layout, weights)
    with pytest.raises(InputError, match="no such file"):
        load_foreign(layout, tmp_path / "absent.pth")


def test_boxes_of_older_releases_are_others(tmp_path: Path) -> None:
    meta = {"mmdet3d_version": "0.17.1"}
    printed = refused(MM, tmp_path, lambda state: None, lambda state: {"state_dict": state, "meta": meta})
    assert "mmdetection3d 0.17.1" in printed
    for version, older in (("pcdet+0.2.0+ab12", True), ("pcdet+0.6.0+ab12", False)):
        wrap = lambda state, version=version: {"model_state": state, "version": version}  # noqa: E731
        if older:
            assert "OpenPCDet pcdet+0.2.0" in refused(PCD, tmp_path, lambda state: None, wrap)
        else:
            load(PCD, tmp_path, wrap=wrap)
