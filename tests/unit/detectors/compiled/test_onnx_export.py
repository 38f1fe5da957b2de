"""Networks on pillars as ONNX files: the same boxes and scores as in torch, for any number of points."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from random_networks import random_net, random_scene

from shift3d.detectors.compiled.onnx_detector import OnnxDetector, onnx_detector
from shift3d.detectors.compiled.onnx_export import onnx_bytes
from shift3d.detectors.models.weights import WEIGHTS_FOLDER
from shift3d.detectors.trained_detector import TrainedDetector
from shift3d.errors import InputError
from shift3d.settings.catalogue.compiled import export_onnx_detector

NAMES = ("pointpillars", "centerpoint")


def odd_scene() -> torch.Tensor:
    """Return many points in one cell, duplicates, points on cell edges, out of range on all sides, and not finite."""
    heap = random_scene(3000)
    heap[:1000, :2] = torch.tensor([10.1, -4.2]) + 0.2 * torch.rand(1000, 2, generator=torch.Generator().manual_seed(1))
    heap[1000:1100, 0] = -74.88 + 0.32 * torch.arange(100)
    far = torch.tensor([[200.0, 0, 1], [0, -200.0, 1], [5, 5, 90.0], [5, 5, -90.0], [74.88, 0, 1], [0, 74.88, 1]])
    return torch.cat((heap, heap[:500], far, torch.full((2, 3), torch.nan), torch.full((1, 3), torch.inf)))


@pytest.mark.parametrize("name", NAMES)
def test_a_file_gives_what_torch_gives_and_says_nothing_of_the_machine(name: str) -> None:
    net = random_net(name)
    content = onnx_bytes(net)
    for word in (b".py", b"site-packages", b"/shift3d/"):
        assert word not in content
    original, compiled = TrainedDetector(net), onnx_detector(content, name)
    for points in (random_scene(9000), random_scene(1), random_scene(0), odd_scene()):
        assert_same(original, compiled, points)


def assert_same(original: TrainedDetector, compiled: OnnxDetector, points: torch.Tensor) -> None:
    one, two = original.proposals(points), compiled.proposals(points)
    scores, kept = torch.sigmoid(one.logits.double()), one.reported
    scores = scores if kept is None else torch.where(kept, scores, 0.0)  # entries that suppression does not receive
    torch.testing.assert_close(scores, torch.sigmoid(two.logits), atol=1e-4, rtol=0)
    torch.testing.assert_close(one.boxes[:, :6], two.boxes[:, :6], atol=1e-2, rtol=1e-3)
    # If the two directions of a box score alike, rounding decides.
    assert float((one.boxes[:, 6] - two.boxes[:, 6]).cos().sub(1).abs().gt(1e-3).float().mean()) < 1e-3


def test_tokens_have_no_export() -> None:
    with pytest.raises(InputError, match=r"sst.* no ONNX export. Export pointpillars or centerpoint"):
        onnx_bytes(random_net("sst"))


def test_weights_below_home_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.safetensors").write_bytes((WEIGHTS_FOLDER / "sst_small.safetensors").read_bytes())
    with pytest.raises(InputError, match="no ONNX export"):  # there is no other obstacle
        export_onnx_detector("sst_small", "~/mine.safetensors")
