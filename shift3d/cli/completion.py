"""What the shell is offered for a word: read from the folders, nothing imported."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.settings.folders import files, places, shipped


def sweep_words(prefix: str, parsed_args: argparse.Namespace | None = None, **_: Any) -> list[str]:
    """Completions of a word after ``shift3d sweep``: plan, status, a sweep's folder, or as :func:`plan_words`."""
    before = list(getattr(parsed_args, "words", None) or [])
    if before[:1] == ["status"]:
        return folder_words(prefix)
    if before:
        return plan_words(prefix)
    return [word for word in ("plan", "status") if word.startswith(prefix)] + plan_words(prefix) + folder_words(prefix)


def plan_words(prefix: str, **_: Any) -> list[str]:
    """Completions of a sweep's name, a job, or an override."""
    key, equals, value = prefix.partition("=")
    if equals and key in ("out", "reuse"):
        return [f"{key}={folder}" for folder in folder_words(value)]
    if prefix.startswith("job="):
        return [f"job={name}" for name in job_names()]
    return [name for name in [*files("sweeps"), "job="] if name.startswith(prefix)] + overrides(prefix)


def job_names() -> list[str]:
    """Names of the specs that ``job=`` takes."""
    return [name for name, path in files("jobs").items() if "\nrunner:" in path.read_text()]


def folder_words(prefix: str, **_: Any) -> list[str]:
    """Completions of a sweep's folder: those in outputs/, and folders on the way to others."""
    head, slash, _name = prefix.rpartition("/")
    places = [Path(f"{head}{slash}").expanduser()] if slash else [Path(), Path("outputs")]
    found = []
    for place in places:
        for folder in sorted(place.glob("*/")):
            word = f"{head}{slash}{folder.name}" if slash else str(folder)
            is_sweep = (folder / "spec.yaml").is_file()
            if word.startswith(prefix) and (is_sweep or slash) and not folder.name.startswith("."):
                found.append(word if is_sweep else f"{word}/")
    return found


def key_words(
    keys: Sequence[str],
    values: Mapping[str, Sequence[str]] = {},
    more: Callable[[str], list[str]] = lambda prefix: [],
) -> Callable[..., list[str]]:
    """A completer of ``key=`` and of the values that a key is known to take. more: what else there is for a prefix."""

    def complete(prefix: str, **_: Any) -> list[str]:
        key, equals, _value = prefix.partition("=")
        words = [f"{key}={value}" for value in values.get(key, ())] if equals else [f"{name}=" for name in keys]
        return [word for word in words if word.startswith(prefix)] + more(prefix)

    return complete


def overrides(prefix: str) -> list[str]:
    """Completions of ``group=option``, ``group.setting=`` ``out=`` and ``reuse=``."""
    key, equals, _ = prefix.partition("=")
    if equals:
        return [f"{key}={option}" for option in files(f"conf/{key}")] if key.isidentifier() else []
    return [f"{name}=" for name in ["out", "reuse", *_settings()] if name.startswith(prefix)]


def _settings() -> list[str]:
    names = set(re.findall(r"^(\w+):", (shipped("conf") / "config.yaml").read_text(), flags=re.MULTILINE))
    names.discard("defaults")
    for path in [file for folder in places("conf") for file in folder.glob("*/*.yaml")]:
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
