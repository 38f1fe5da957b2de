"""Results of Waymo's own metrics library for crowded random frames, at every score cut-off.

They are in tests/reference/waymo_ap.json, beside the script that computed them with the library.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames_by_hand import frame

from shift3d.evaluation.frames import DetectedFrame, compare
from shift3d.evaluation.waymo import assign, waymo_curve

REFERENCE = json.loads((Path(__file__).parents[2] / "reference" / "waymo_ap.json").read_text())
ANSWERS: list[dict[str, Any]] = REFERENCE["answers"]


def _frames() -> list[DetectedFrame]:
    return [
        frame(
            np.array(made["truth"]),
            np.array(made["found"]),
            made["scores"],
            points=[6 if level == 1 else 5 for level in made["level"]],
            labelled=made["labelled"],
        )
        for made in REFERENCE["frames"]
    ]


def test_the_reference_is_no_easy_case() -> None:
    """Detections compete, both levels occur, and some boxes have no label."""
    competing = sum(int(((compare(f, "BEV").overlap >= 0.5).sum(axis=1) > 1).sum()) for f in _frames())
    assert competing >= 5
    values = np.array([[answer["ap"], answer["aph"]] for answer in ANSWERS])
    assert len(ANSWERS) == 32 and values.min() > 0.1 and values.max() < 0.9 and (values[:, 1] < values[:, 0]).all()
    assert sum(not flag for made in REFERENCE["frames"] for flag in made["labelled"]) >= 5


@pytest.mark.parametrize(
    "answer", ANSWERS, ids=lambda a: f"{a['view']}-{a['iou_threshold']}-{a['range_m']}-{a['level']}"
)
def test_equal_to_the_library(answer: dict[str, Any]) -> None:
    low, high = answer["range_m"]
    cuts = [
        assign(compare(item, answer["view"]), answer["iou_threshold"], low, np.inf if high is None else high)
        for item in _frames()
    ]
    curve = waymo_curve(cuts, f"LEVEL_{answer['level']}")
    # The library computes in float32.
    assert curve.average_precision == pytest.approx(answer["ap"], abs=2e-6)
    assert curve.average_precision_heading == pytest.approx(answer["aph"], abs=2e-6)
    for name in ("precision", "recall", "heading_precision"):
        if name in answer:
            np.testing.assert_allclose(getattr(curve, name), answer[name], atol=2e-6)
