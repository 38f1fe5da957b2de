"""Output of ``shift3d --version``: the versions that a defect report should name."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import shift3d

_LIBRARIES = ("torch", "ray")


def version_lines() -> str:
    """Format the versions of shift3d (with its commit), Python, torch and Ray, one per line, without importing them."""
    commit = _commit(Path(shift3d.__file__).resolve().parents[1])
    own = f"shift3d {shift3d.__version__}" + (f", commit {commit}" if commit else "")
    return "\n".join([own, f"Python {platform.python_version()}", *map(_library, _LIBRARIES)])


def _commit(checkout: Path) -> str:
    """Return the commit of a checkout, with "-dirty" if tracked files differ; empty without git or a checkout."""
    if not (checkout / ".git").exists():
        return ""
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        found = subprocess.run(command, capture_output=True, text=True, check=False, timeout=5)
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip() if found.returncode == 0 else ""


def _library(name: str) -> str:
    try:
        return f"{name} {version(name)}"
    except PackageNotFoundError:
        return f"{name} is not installed"
