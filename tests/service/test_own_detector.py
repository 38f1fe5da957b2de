"""The guide's page on your own detector, followed: file written, sweep run by two Ray workers, table printed."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from shift3d.cli.main import main

REPOSITORY = Path(__file__).resolve().parents[2]
GUIDE = (REPOSITORY / "docs" / "guides" / "detectors.md").read_text()
FEW = ("vehicle=suv", "attack.steps=1", "attack.noise_replicates=0")
"""Words that shorten the command: a command's last words override earlier ones."""


def words_of(command: str) -> list[str]:
    """Return the words of one of the guide's commands."""
    program, *words = shlex.split(command)
    assert program == "shift3d"
    return [*words, *FEW]


@pytest.mark.slow
def test_the_guide_is_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = re.search(r"for example `(\S+\.py)`:\n\n```python\n(.*?)```", GUIDE, re.DOTALL)
    command = re.search(r"^shift3d sweep .*detector=own.*$", GUIDE, re.MULTILINE)
    assert source is not None and command is not None
    file, words = tmp_path / source[1], words_of(command[0])
    file.write_text(source[2])
    run = [sys.executable, "-m", "shift3d", *words]
    known = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(run, cwd=tmp_path, env=known, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "AUC" in done.stdout and "own" in done.stdout and "2 workers" in done.stdout + done.stderr
    scores = pd.read_parquet(tmp_path / "outputs" / "mine" / "final" / "scores.parquet")
    assert set(scores["detector"]) == set(scores["scored_by"]) == {"own"}
    assert set(scores["method"]) >= {"baseline", "random", "adversarial"} and scores["score"].max() > 0.1
    monkeypatch.chdir(tmp_path)
    # The digest of the file is part of the sweep: another file is another sweep.
    file.write_text(source[2].replace("gain: float = 2.0", "gain: float = 1.0"))
    assert main(words) == 2 and "holds another sweep" in capsys.readouterr().err
    file.write_text(source[2].replace("def load", "def lead"))
    here = [word for word in words if not word.startswith(("runner", "out="))]
    assert main([*here, "runner=local", "out=outputs/other"]) == 2
    assert "no function load" in capsys.readouterr().err
