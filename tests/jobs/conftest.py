"""The wheel of shift3d, and an environment that has nothing else of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from jobs.ray_head import PACKED, REPOSITORY

FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md")


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy because setuptools leaves files beside its build. Nothing is downloaded."""
    folder = tmp_path_factory.mktemp("build")
    for name in PACKED:
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(REPOSITORY / name, folder)
    words = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", "-w", str(folder / "dist"), str(folder)]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *words], check=True)
    (built,) = (folder / "dist").glob("*.whl")
    return built


@pytest.fixture(scope="session")
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
