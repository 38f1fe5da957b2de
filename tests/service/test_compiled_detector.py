"""The shipped PointPillars as an ONNX file: its scores, and a sweep that uses scores alone."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest

from shift3d.cli.main import main


@pytest.mark.slow
def test_the_shipped_detector_is_compiled_and_attacked_by_its_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every evaluation of the file is a full pass: the test runs one task with the fewest evaluations of its search.

    tests/unit/settings/test_compiled.py compares a sweep's file with its original.
    """
    monkeypatch.chdir(tmp_path)
    assert main(["compile", "detector=pointpillars", "to=pp.onnx"]) == 0
    shown = capsys.readouterr()
    assert "exporting pointpillars:   0%" in shown.err and "3/3" in shown.err
    within = re.search(r"pp\.onnx: .* scores within (\S+) of pointpillars's", shown.out)
    assert within is not None and float(within[1]) < 1e-4, "on a street of either sensor"
    words = [
        "detector=onnx",
        "detector.file=pp.onnx",
        "attack.random_replicates=0",
        "attack.steps=1",
        "vehicle=coupe",
        "mode=pose",
        "naturalness=none",
        "runner=local",
        "tracking=none",
        "out=mine",
    ]
    assert main(["sweep", "smoke", *words]) == 2 and "attack.search=evolution" in capsys.readouterr().err
    assert main(["sweep", "smoke", *words, "attack.search=evolution"]) == 0
    printed = "".join(capsys.readouterr())
    assert "pp.onnx: scores are compared with no original" in printed, (
        "tests/unit/settings/test_compiled.py compares with one"
    )
    scores = pd.read_parquet(tmp_path / "mine" / "final" / "scores.parquet")
    assert set(scores["detector"]) == {"onnx"} and set(scores["scored_by"]) == {"onnx", "pointpillars"}
    assert set(scores["method"]) == {"baseline", "adversarial"}
    both = scores.pivot_table(index=["task_id", "method", "replicate"], columns="scored_by", values="score")
    assert (both["onnx"] - both["pointpillars"]).abs().max() < 1e-3 and both["onnx"].max() > 0.1
