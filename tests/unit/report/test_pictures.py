"""The README's pictures show what the tables say."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd

from shift3d.report.pictures import draw_curves


def test_curves_are_of_the_attacked_detector_alone(tmp_path: Path) -> None:
    common = {"vehicle": "suv", "mode": "pose", "lambda": 1.0, "method": "baseline", "detector": "pointpillars"}
    scores = pd.DataFrame(
        [common | {"scored_by": "pointpillars", "score": 0.8}, common | {"scored_by": "sst_small", "score": 0.2}]
    )
    auc = pd.DataFrame([common | {"selected": True}])
    with mpl.rc_context({"svg.fonttype": "none"}):
        draw_curves(scores, auc, tmp_path / "curves.svg")
    drawn = (tmp_path / "curves.svg").read_text()
    assert "baseline 0.80" in drawn and "baseline 0.50" not in drawn
