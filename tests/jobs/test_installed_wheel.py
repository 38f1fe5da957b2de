"""shift3d from its wheel alone, in an empty folder: a user's own sweep with its report.

The machines of test_jobs_start_the_same_sweep.py have the wheel alone, too.
"""

from __future__ import annotations

import os
import subprocess
import zipfile
from pathlib import Path

import pandas as pd
import pytest
from jobs.ray_head import PACKED, REPOSITORY

pytestmark = pytest.mark.slow


def environment(**more: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more


def run(python: Path, folder: Path, *words: str, **more: str) -> str:
    """Run a command of the installed shift3d, which must succeed. Returns its output."""
    command = [str(python.parent / "shift3d"), *words]
    done = subprocess.run(
        command, cwd=folder, env=environment(**more), capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, f"{words}: {done.stdout[-2000:]} {done.stderr[-2000:]}"
    return done.stdout


def test_it_carries_every_file_that_is_no_code(wheel: Path) -> None:
    carried = set(zipfile.ZipFile(wheel).namelist())
    for folder in PACKED:
        for path in (REPOSITORY / folder).rglob("*"):
            name = path.relative_to(REPOSITORY).as_posix()
            if path.is_file() and "__pycache__" not in name:
                assert (name if folder == "shift3d" else f"shift3d/_data/{name}") in carried


def test_a_sweep_of_ones_own_in_an_empty_folder(python: Path, tmp_path: Path) -> None:
    where = [str(python), "-c", "import shift3d; print(shift3d.__file__)"]
    found = subprocess.run(where, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True).stdout
    assert Path(found.strip()).is_relative_to(python.parents[1])
    assert run(python, tmp_path, "jobs", "kuberay") == (REPOSITORY / "jobs" / "kuberay.yaml").read_text()
    completion = {"_ARGCOMPLETE": "1", "COMP_LINE": "shift3d sweep smoke vehicle=su", "_ARGCOMPLETE_IFS": "\n"}
    completion |= {"COMP_POINT": "30", "_ARGCOMPLETE_COMP_WORDBREAKS": " ", "_ARGCOMPLETE_STDOUT_FILENAME": "answer"}
    run(python, tmp_path, **completion)
    assert (tmp_path / "answer").read_text().strip() == "vehicle=suv"

    (tmp_path / "sweeps").mkdir()
    (tmp_path / "conf" / "attack").mkdir(parents=True)
    (tmp_path / "sweeps" / "mine.yaml").write_text("defaults: [smoke, override /attack: tiny, _self_]\nmode: pose\n")
    (tmp_path / "conf" / "attack" / "tiny.yaml").write_text(
        "defaults: [short, _self_]\nsteps: 1\nrandom_replicates: 0\n"
    )
    words = ["mode=pose", "vehicle=suv", "accuracy=draft", "accuracy.render.sdf_grid=false", "naturalness=none"]
    words += ["runner=local", "tracking=none"]
    assert "out/final written" in run(python, tmp_path, "sweep", "mine", *words, "out=out", OMP_NUM_THREADS="1")
    scores = pd.read_parquet(tmp_path / "out" / "final" / "scores.parquet")
    assert set(scores["vehicle"]) == {"suv"} and scores["score"].notna().all()
    assert set(scores.loc[scores["method"] != "adversarial", "status"]) == {"ok"}
    assert set(scores["status"]) <= {"ok", "no_valid_step"}, "the only step of a search may break a constraint"
    run(python, tmp_path, "report", "out", "--cases", "1")
    assert "mine" in (tmp_path / "out" / "report.html").read_text()
