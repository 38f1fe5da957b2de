"""The shipped PointPillars as an ONNX file: its scores, and a sweep that two Ray workers run on them alone."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
import torch

from shift3d.cli.main import main
from shift3d.detectors.compiled.onnx_detector import load_onnx
from shift3d.detectors.loading import load_detector
from shift3d.scenes.sets import StreetScenes

REPOSITORY = Path(__file__).resolve().parents[2]


def shift3d(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "shift3d", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=900,
    )


@pytest.mark.slow
def test_the_shipped_detector_is_compiled_and_attacked_by_its_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["compile", "detector=pointpillars", "to=pp.onnx"]) == 0  # compared on streets of both sensors, to 1e-3
    original, compiled = load_detector("pointpillars"), load_onnx(tmp_path / "pp.onnx")
    scenes = StreetScenes("waymo_top", seed=5)
    scene = scenes.load(scenes.names()[0])
    points = torch.from_numpy(scene.points) - torch.tensor([0.0, 0.0, scene.ground_z_m])
    one, two = original.proposals(points), compiled.proposals(points)
    assert float((torch.sigmoid(one.logits) - torch.sigmoid(two.logits)).abs().max()) < 1e-4
    words = ["detector=onnx", "detector.file=pp.onnx", "detector.original=pointpillars", "attack.random_search=1"]
    words += [
        "attack.random_replicates=0",
        "attack.noise_replicates=0",
        "attack.steps=1",
        "vehicle=coupe",
        "runner=ray",
        "runner.workers=2",
        "tracking=none",
        "out=mine",
        "naturalness=none",
    ]
    capsys.readouterr()
    assert main(["sweep", "smoke", *words]) == 2 and "attack.search=evolution" in capsys.readouterr().err
    done = shift3d(tmp_path, "sweep", "smoke", *words, "attack.search=evolution")
    assert done.returncode == 0, done.stderr[-3000:]
    assert (
        "pp.onnx: scores are those of pointpillars within" in done.stdout and "2 workers" in done.stdout + done.stderr
    )
    scores = pd.read_parquet(tmp_path / "mine" / "final" / "scores.parquet")
    assert set(scores["detector"]) == {"onnx"} and set(scores["scored_by"]) == {"onnx", "pointpillars"}
    assert set(scores["method"]) >= {"baseline", "random_search", "adversarial"}
    both = scores.pivot_table(index=["task_id", "method", "replicate"], columns="scored_by", values="score")
    assert (both["onnx"] - both["pointpillars"]).abs().max() < 1e-3 and both["onnx"].max() > 0.1
