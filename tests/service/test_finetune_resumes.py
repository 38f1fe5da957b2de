"""A fine-tuning that is killed resumes with the same command, and ends in the table of an undisturbed one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from shift3d.cli.main import main

WORDS = ("finetune", "scenes.count=1", "scenes.sensor=hdl64", "scenes.traffic=family", "vehicle=suv", "others=kei_car",
         "attack.steps=1", "accuracy.render.sdf_grid=false", "seeds=0", "streets=1", "runner=local", "tracking=none",
         "rate=1e-3", "detector=sst_small", "attack.placement.min_range_m=38",
         "attack.placement.min_object_points=50")  # fmt: skip
"""The smallest detector (test_tune.py tunes PointPillars), and vehicles that few beams meet."""


def killed_when(file: Path, out: Path) -> None:
    """Run the command in its own process, and kill it as soon as a file exists."""
    command = [sys.executable, "-m", "shift3d", *WORDS, f"out={out}"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
    end = time.monotonic() + 300
    while not file.exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    errors = process.communicate()[1].decode()
    assert process.returncode == -signal.SIGKILL, errors


@pytest.mark.slow
def test_killed_in_its_training_and_resumed_it_gives_the_same_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    killed_when(out / "finetuned-rate1e-3-0" / "checkpoint.pt", out)
    segments = sorted((out / "attacked" / "data").iterdir())
    assert main([*WORDS, f"out={out}"]) == 0
    printed = capsys.readouterr().out
    assert "0.482" in printed and "0.751" in printed
    assert sorted((out / "attacked" / "data").iterdir()) == segments, "no task runs twice"
    tuned, alone = out / "finetuned-rate1e-3-0", tmp_path / "alone"
    words = [f"finetune={out / 'attacked'}", "method=adversarial", "start_from=shipped", "recipe.seed=0"]
    words += ["recipe.peak_rate=1e-3", "threads=1", "mlflow=none", f"out={alone}"]
    assert main(["train", "model=sst_small", *words]) == 0
    assert (alone / "sst_small.safetensors").read_bytes() == (tuned / "sst_small.safetensors").read_bytes()
    table = (out / "finetune.parquet").read_bytes()
    (out / "finetune.parquet").unlink()
    assert main([*WORDS, f"out={out}"]) == 0, "what is done is not done again"
    assert (out / "finetune.parquet").read_bytes() == table
    rows = pq.read_table(out / "finetune.parquet").to_pandas()
    assert set(rows["objects"].dropna()) == {"baseline", "adversarial", "adversarial_adaptive"}
    assert set(rows["scene_set"]) == {"held_out", "other_vehicles", "natural"}
    assert (rows[rows["model"] == "finetuned"]["gain"].abs() > 0).any()
    facts = json.loads((out / "finetuned-rate1e-3-0" / "sst_small.json").read_text())
    assert facts["finetuned_on"]["objects"] == 1 and facts["rate"] == 1e-3
