"""What the shell is offered for a sweep's name and its overrides: read from the folders, nothing imported."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

__all__ = ["overrides", "sweep_words"]

_ROOT = Path(__file__).resolve().parents[2]


def sweep_words(prefix: str, **_: Any) -> list[str]:
    """Completions of a word after ``shift3d sweep``: a sweep's name, a job, or an override."""
    if prefix.startswith("job="):
        specs = (path for path in (_ROOT / "jobs").glob("*.yaml") if "\nrunner:" in path.read_text())
        return sorted(f"job={path.stem}" for path in specs)
    names = sorted(path.stem for path in (_ROOT / "sweeps").glob("*.yaml"))
    return [name for name in [*names, "job="] if name.startswith(prefix)] + overrides(prefix)


def overrides(prefix: str) -> list[str]:
    """Completions of ``group=option``, ``group.setting=`` ``out=`` and ``reuse=``."""
    key, equals, _ = prefix.partition("=")
    if equals:
        options = sorted(path.stem for path in (_ROOT / "conf" / key).glob("[!_]*.yaml")) if key.isidentifier() else []
        return [f"{key}={option}" for option in options]
    return [f"{name}=" for name in ["out", "reuse", *_settings()] if name.startswith(prefix)]


def _settings() -> list[str]:
    names = set(re.findall(r"^(\w+):", (_ROOT / "conf" / "config.yaml").read_text(), flags=re.MULTILINE))
    names.discard("defaults")
    for path in (_ROOT / "conf").glob("*/*.yaml"):
        group = path.parent.name
        names.add(group)
        if path.read_text().startswith("# @package _global_"):
            continue  # it sets what stands elsewhere
        parents: list[str] = []
        for indent, name in re.findall(r"^( *)(\w+):", path.read_text(), flags=re.MULTILINE):
            parents = [*parents[: len(indent) // 2], name]
            if name not in ("defaults", "kind"):
                names.add(".".join([group, *parents]))
    return sorted(names)
