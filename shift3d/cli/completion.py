"""Tab completion of command words, read from the folders without heavy imports."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from shift3d.settings.folders import files, places, shipped


def sweep_words(prefix: str, parsed_args: argparse.Namespace | None = None, **_: Any) -> list[str]:
    """Complete a word after ``shift3d sweep``: plan, status, a sweep's folder, or as :func:`plan_words`."""
    before = list(getattr(parsed_args, "words", None) or [])
    if before[:1] == ["status"]:
        return folder_words(prefix)
    if before:
        return plan_words(prefix)
    return [word for word in ("plan", "status") if word.startswith(prefix)] + plan_words(prefix) + folder_words(prefix)


def plan_words(prefix: str, **_: Any) -> list[str]:
    """Complete a sweep's name, a job, or an override."""
    key, equals, value = prefix.partition("=")
    if equals and key in ("out", "reuse"):
        return [f"{key}={folder}" for folder in folder_words(value)]
    if prefix.startswith("job="):
        return [f"job={name}" for name in job_names()]
    return [name for name in [*files("sweeps"), "job="] if name.startswith(prefix)] + overrides(prefix)


def job_names() -> list[str]:
    """Return the names of the launch specs that ``job=`` accepts."""
    return [name for name, path in files("jobs").items() if "\nrunner:" in path.read_text()]


def folder_words(prefix: str, **_: Any) -> list[str]:
    """Complete a sweep's folder: sweeps in outputs/, or, after a slash, sweeps and the folders on the way to them."""
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
    """Return a completer of ``key=`` and of a key's known values. more: further completions of a prefix."""

    def complete(prefix: str, **_: Any) -> list[str]:
        key, equals, _value = prefix.partition("=")
        words = [f"{key}={value}" for value in values.get(key, ())] if equals else [f"{name}=" for name in keys]
        return [word for word in words if word.startswith(prefix)] + more(prefix)

    return complete


def runner_words(prefix: str, **_: Any) -> list[str]:
    """Complete a setting of the runner, for commands that accept no other settings."""
    return [word for word in overrides(prefix) if word.startswith("runner")]


def retrieval_words(prefix: str, **_: Any) -> list[str]:
    """Complete a word after ``shift3d retrieve OUT``: the pool's folder, or an override."""
    key, equals, value = prefix.partition("=")
    if equals and key == "pool":
        return [f"pool={folder}" for folder in folder_words(value)]
    return [name for name in ["pool="] if name.startswith(prefix)] + overrides(prefix)


def overrides(prefix: str) -> list[str]:
    """Complete ``group=option``, ``group.setting=``, ``setting=value``, ``out=`` and ``reuse=``; the last value of an
    axis, as in ``group=option,option``."""
    key, equals, value = prefix.partition("=")
    if equals:
        options = [*(files(f"conf/{key}") if key.isidentifier() else []), *_settings().get(key, ())]
        before, comma, last = value.rpartition(",")
        left = [option for option in options if option not in before.split(",") and option.startswith(last)]
        return [f"{key}={before}{comma}{option}" for option in left]
    return [f"{name}=" for name in ["out", "reuse", *sorted(_settings())] if name.startswith(prefix)]


def _settings() -> dict[str, list[str]]:
    """Read every group and setting of conf/, with the values that the setting's comment lists."""
    top = _lines((shipped("conf") / "config.yaml").read_text())
    names = {parents[0]: values for parents, values in top if len(parents) == 1 and parents != ["defaults"]}
    for path in [file for folder in places("conf") for file in folder.glob("*/*.yaml")]:
        group, text = path.parent.name, path.read_text()
        names.setdefault(group, [])
        if text.startswith("# @package _global_"):
            continue  # a file of this package sets settings of other groups
        for parents, values in _lines(text):
            if parents[-1] not in ("defaults", "kind"):
                known = names.setdefault(".".join([group, *parents]), [])
                known += [value for value in values if value not in known]
    return names


def _lines(text: str) -> list[tuple[list[str], list[str]]]:
    """Parse a file of conf/: of each setting the path, outermost name first, and the values. A comment
    ``# a (why) | b`` lists the values; otherwise a boolean setting has true and false."""
    found: list[tuple[list[str], list[str]]] = []
    parents: list[str] = []
    for indent, name, value, comment in re.findall(r"^( *)(\w+):[ ]*([^#\n]*)(.*)", text, flags=re.MULTILINE):
        parents = [*parents[: len(indent) // 2], name]
        first, *others = comment.split(" | ")
        listed = [*re.findall(r"(\w+)(?: \([^)]*\))?$", first), *(re.split(r"\W", part)[0] for part in others)]
        truth = ["true", "false"] if value.strip() in ("true", "false") else []
        found.append((parents, listed if others else truth))
    return found
