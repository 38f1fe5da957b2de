"""shift3d from its wheel alone, in an empty folder: a user's own sweep with its report, and Ray workers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pandas as pd
import pytest
from jobs.ray_head import REPOSITORY, SERVICE, ray_head
from service.drivers import DETERMINISTIC, Drivers

pytestmark = pytest.mark.slow

FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md")
FOLDERS = ("shift3d", "conf", "sweeps", "jobs")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy because setuptools leaves files beside its build. Nothing is downloaded."""
    folder = tmp_path_factory.mktemp("build")
    for name in FOLDERS:
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(REPOSITORY / name, folder)
    words = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "-w", str(folder / "dist"), str(folder)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *words], check=True)
    (built,) = (folder / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment with the wheel and the libraries of the tests' own environment."""
    folder = tmp_path_factory.mktemp("venv")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    found = folder / "bin" / "python"
    words = ["--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run([sys.executable, "-m", "pip", "--python", str(found), "install", *words], check=True)
    # A plain path: it leaves out the import hook by which an editable install of shift3d is found.
    site = sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)})
    (Path(site) / "libraries.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return found


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
    for folder in FOLDERS:
        for path in (REPOSITORY / folder).rglob("*"):
            name = path.relative_to(REPOSITORY).as_posix()
            if path.is_file() and "__pycache__" not in name:
                assert (name if folder == "shift3d" else f"shift3d/_data/{name}") in carried


def test_a_sweep_of_ones_own_in_an_empty_folder(python: Path, tmp_path: Path) -> None:
    where = [str(python), "-c", "import shift3d; print(shift3d.__file__)"]
    found = subprocess.run(where, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True).stdout
    assert Path(found.strip()).is_relative_to(python.parents[1])
    assert "sweep smoke: 4 tasks" in run(python, tmp_path, "sweep", "plan", "smoke")
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


def test_two_machines_of_a_cluster_that_have_the_wheel_alone(
    python: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = "sweep default scenes.count=4 tracking=none"
    with ray_head(None, python=str(python), path=str(SERVICE)) as found:
        slow = environment(**found, SHIFT3D_TEST_SECONDS="0.1")
        command = f"shift3d {words} job=ray_cluster runner.workers=2 out=cluster"
        subprocess.run(["bash", "-c", command], cwd=tmp_path, env=slow, timeout=600, check=True)
    monkeypatch.syspath_prepend(SERVICE)  # for the kind of task
    code, _, errors = Drivers(tmp_path).run_here([*words.split(), "runner=local", "out=here"])
    assert code == 0, errors
    assert len(set(pd.read_parquet(tmp_path / "cluster" / "final" / "attempts.parquet")["worker"])) == 2
    for table in DETERMINISTIC:
        file = Path("final") / f"{table}.parquet"
        assert (tmp_path / "cluster" / file).read_bytes() == (tmp_path / "here" / file).read_bytes()
