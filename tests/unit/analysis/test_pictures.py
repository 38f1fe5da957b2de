"""The README's pictures show what the tables say."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import pandas as pd
import pytest
from scripts.pictures import draw_curves, main

from shift3d.errors import InputError


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


def test_a_folder_that_is_no_sweep_is_named_and_nothing_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="usage"):
        main([f"folder={tmp_path / 'pictures'}"])
    with pytest.raises(InputError, match="elsewhere"):
        main([str(tmp_path / "elsewhere"), f"folder={tmp_path / 'pictures'}"])
    assert not (tmp_path / "pictures").exists()
