"""A sweep reports a detector that fails in every task, or detects no vehicle."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.cli.main import main
from shift3d.exit_codes import ExitCode

FAILS_ON_A_SCENE = """
import torch
def load(weights):
    def detect(points):
        assert len(points) < 3000, "too many"
        return torch.ones(1, 7), points.sum()[None]
    return detect
"""
LOOKS_ELSEWHERE = """
import torch
def load(weights):
    return lambda points: (torch.tensor([[0.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]]), points.sum()[None] * 1e-3)
"""
ONE_TASK = ["smoke", "vehicle=suv", "mode=pose", "attack.steps=1", "accuracy.render.sdf_grid=false"]
HERE = ["runner=local", "tracking=none", "out=out", "detector=own", "detector.module=mine.py", "detector.scored_by=[]"]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_failed_tasks_are_named_and_no_table_is_empty(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.py").write_text(FAILS_ON_A_SCENE)
    assert main(["sweep", *ONE_TASK, *HERE]) == ExitCode.INCOMPLETE == 3
    _, printed = capsys.readouterr().out.split("writing to out\n")
    assert "0 of 1 task scored" in printed and "mine.py, line 5: AssertionError: too many" in printed
    assert "AUC" not in printed and "verify" not in printed


def test_a_detector_that_sees_no_vehicle_is_said_before_its_aucs(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.py").write_text(LOOKS_ELSEWHERE)
    assert main(["sweep", *ONE_TASK, *HERE]) == 0
    _, printed = capsys.readouterr().out.split("writing to out\n")
    assert "own: in every task" in printed
    assert printed.index("Does the detector see the vehicle at all?") < printed.index("AUC, adversarial pose")
