"""A compiled detector is compared with its original wherever either has a detection."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch
from onnx_files import BOXES, OWN_SOURCE, write_model

from shift3d.detectors.base import Detections
from shift3d.detectors.compiled.agreement import TOLERANCE, check_score_agreement, largest_disagreement
from shift3d.detectors.compiled.onnx_detector import OnnxDetector, load_onnx
from shift3d.detectors.user_detector import UserDetector, load_user_detector
from shift3d.errors import InputError


def pair(folder: Path, bias: float = 0.0, **parts: object) -> tuple[UserDetector, OnnxDetector]:
    (folder / "own.py").write_text(OWN_SOURCE)
    return load_user_detector(folder / "own.py", None), load_onnx(write_model(folder / "mine.onnx", bias, **parts))


@dataclasses.dataclass
class OneBox:
    """Detector that finds one box with a given score."""

    score: float
    name: str = "own"

    def detect(self, points: torch.Tensor, score_threshold: float = 0.1) -> Detections:
        kept = [self.score] if self.score >= score_threshold else []
        return Detections(np.tile((5.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0), (len(kept), 1)), np.array(kept))


def clouds() -> list[tuple[str, torch.Tensor]]:
    draw = torch.Generator().manual_seed(0)
    return [(name, torch.rand(300, 3, generator=draw) * 20.0) for name in ("one", "two")]


def test_the_same_function_agrees(tmp_path: Path) -> None:
    assert check_score_agreement(*pair(tmp_path), clouds(), "mine.onnx").difference < 1e-6


@pytest.mark.parametrize("bias", [3.9e-3, -3.9e-3])
def test_less_than_the_tolerance_is_taken(tmp_path: Path, bias: float) -> None:
    """A score near one half changes by a quarter of its logit."""
    assert 0.9 * TOLERANCE < check_score_agreement(*pair(tmp_path, bias), clouds(), "mine.onnx").difference < TOLERANCE


@pytest.mark.parametrize(("other", "differs"), [(0.0999, False), (0.098, True)])
def test_a_box_just_below_the_least_score_is_looked_at(other: float, differs: bool) -> None:
    """0.1003 in one and 0.0999 in the other is a difference of 0.0004, not of 0.1003."""
    one, two = OneBox(0.1003), OneBox(other)
    if differs:
        with pytest.raises(InputError, match=r"against 0\.1003"):
            check_score_agreement(one, two, clouds(), "mine.onnx")
    else:
        assert check_score_agreement(one, two, clouds(), "mine.onnx").difference == pytest.approx(4e-4)


def test_more_is_refused_with_place_and_scores(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"differs from own's by 0\.0012.*0\.4\d+ against 0\.4\d+ in two at \(.*\) m"):
        check_score_agreement(*pair(tmp_path, 5e-3), clouds(), "mine.onnx")


def test_a_box_that_one_of_them_does_not_have_counts_whole(tmp_path: Path) -> None:
    boxes = BOXES.copy()
    boxes[1, :2] += 30.0
    worst = largest_disagreement(*pair(tmp_path, boxes=boxes), clouds())
    assert worst is not None and worst.difference == pytest.approx(0.5, abs=0.05)
    assert min(worst.original, worst.compiled) == 0.0


def test_nothing_found_compares_nothing(tmp_path: Path) -> None:
    own, _ = pair(tmp_path)
    blind = load_onnx(write_model(tmp_path / "mine.onnx", -9.0))
    with pytest.raises(InputError, match="neither it nor onnx finds a box"):
        check_score_agreement(blind, blind, clouds(), "mine.onnx")
    assert own.name == "own"
