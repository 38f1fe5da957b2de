"""``make sweep``: the command that make would run, without running it."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make")


def command(*words: str) -> list[str]:
    """Return the words of the last command that make would run."""
    # A make that runs the tests tells its children to print their folder, and passes its own ARGS to them.
    given = ("ARGS", "SWEEP", "OUT")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", *given))}
    done = subprocess.run(["make", "-n", *words], cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return shlex.split(done.stdout.splitlines()[-1])[1:]


def test_words_that_make_takes_for_variables_reach_the_command() -> None:
    assert command("sweep") == ["sweep", "default"]
    assert command("sweep", "SWEEP=kitti", "ARGS=scenes.root=a out=b") == ["sweep", "kitti", "scenes.root=a", "out=b"]
    given = command("sweep", "out=/proc/x", "effects=[fog,rain]", "scenes.count=3")
    assert given[:2] == ["sweep", "default"]
    assert sorted(given[2:]) == ["effects=[fog,rain]", "out=/proc/x", "scenes.count=3"]
    assert command("sweep", "out=") == ["sweep", "default", "out="]
    assert command("verify", "OUT=here", "runner=local") == ["verify", "here", "runner=local"]


@pytest.mark.parametrize("target", ["verify", "report", "retry-quarantined"])
def test_a_sweep_that_nobody_named_is_asked_for_before_anything_is_installed(target: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "OUT"))}
    done = subprocess.run(["make", target], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout.strip() == f"which sweep? make {target} OUT=outputs/NAME-HASH"
    assert not (tmp_path / ".venv").exists()


@pytest.mark.parametrize("words", [["sweep", "smoke"], ["report", "outputs/smoke-0123"], ["swep"]])
def test_a_word_that_is_no_target_is_refused_before_anything_runs(words: list[str], tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "OUT"))}
    done = subprocess.run(["make", *words], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and f"unknown: {words[-1]}. A sweep is named by SWEEP=NAME" in done.stderr
    assert not done.stdout and not (tmp_path / ".venv").exists()
