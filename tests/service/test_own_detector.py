"""The guide's page on your own detector, word for word: file written, sweep run by two Ray workers, table printed."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
GUIDE = (REPOSITORY / "docs" / "guides" / "detectors.md").read_text()


def shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run one of the guide's commands in a folder; shift3d is the one under test."""
    program, *words = shlex.split(command)
    assert program == "shift3d"
    return subprocess.run(
        [sys.executable, "-m", "shift3d", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=900,
    )


@pytest.mark.slow
def test_the_guide_is_followed_word_for_word(tmp_path: Path) -> None:
    source = re.search(r"for example `(\S+\.py)`:\n\n```python\n(.*?)```", GUIDE, re.DOTALL)
    command = re.search(r"^shift3d sweep .*detector=own.*$", GUIDE, re.MULTILINE)
    assert source is not None and command is not None
    file = tmp_path / source[1]
    file.write_text(source[2])
    done = shell(command[0], tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "AUC" in done.stdout and "own" in done.stdout and "2 workers" in done.stdout + done.stderr
    scores = pd.read_parquet(tmp_path / "outputs" / "mine" / "final" / "scores.parquet")
    assert set(scores["detector"]) == set(scores["scored_by"]) == {"own"}
    assert set(scores["method"]) >= {"baseline", "random", "adversarial"} and scores["score"].max() > 0.1
    # The digest of the file is part of the sweep: another file is another sweep.
    file.write_text(source[2].replace("gain: float = 2.0", "gain: float = 1.0"))
    refused = shell(command[0], tmp_path)
    assert refused.returncode == 2 and "holds another sweep" in refused.stderr
    file.write_text(source[2].replace("def load", "def lead"))
    refused = shell(command[0].replace("outputs/mine", "outputs/other"), tmp_path)
    assert refused.returncode != 0 and "no function load" in refused.stdout + refused.stderr
