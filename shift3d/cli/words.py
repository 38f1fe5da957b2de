"""The words after ``shift3d sweep`` and ``shift3d plan``: a sweep or its folder, overrides, and where it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shift3d.cli.command import take_words
from shift3d.cli.completion import runner_words
from shift3d.errors import InputError
from shift3d.settings.folders import files

if TYPE_CHECKING:
    from shift3d.cli.job_spec import JobSpec
    from shift3d.settings.schema.config import RunnerConfig
    from shift3d.store.location import Location


SWEEP_WORDS = "the sweep's name, overrides, out=DIR for the folder to write to, job=NAME for where it runs"
SWEEP_METAVAR = "NAME | key=value"
RUNNER = ("where it runs: settings of conf/runner", "runner=...", runner_words)
"""Help, metavar and completions of the words of commands that `runner_of` reads."""


@dataclass(frozen=True)
class Request:
    """What a command line asks for.

    out: the folder to write to; None: the usual one. reuse: folders of other sweeps. job: the launch spec, whose
    runner is part of the overrides.
    """

    name: str
    overrides: list[str]
    out: Location | None
    reuse: list[Location]
    job: JobSpec | None


def read_words(words: Sequence[str]) -> Request:
    """Words to what they ask for.

    Raises: InputError: a folder that cannot be used, a job that there is not, or a sweep's folder that is damaged.
    """
    from shift3d.cli.job_spec import take_job
    from shift3d.sweep.planning.spec_file import read_spec

    reuse, rest = take_folders("reuse", words)
    for folder in reuse:
        read_spec(folder)  # before scenes are looked at, which may take minutes
    job, typed = take_job(rest)
    name, overrides, out = split_words(_words_of_folder(typed))
    if job:
        # Not the runner that the folder was begun with.
        overrides = [word for word in overrides if word in typed or not word.startswith("runner")]
        overrides = [*job.overrides(overrides), *overrides]
    return Request(name, overrides, out, reuse, job)


def split_words(words: Sequence[str]) -> tuple[str, list[str], Location | None]:
    """Words to (name, overrides, out).

    Raises: InputError: out= is empty, or a URL that cannot be used.
    """
    name = "default"
    if words and "=" not in words[0] and not words[0].startswith(("+", "~")):
        name, words = words[0], words[1:]
    out, rest = take_folders("out", words)
    return name, rest, out[-1] if out else None


def take_folders(key: str, words: Sequence[str]) -> tuple[list[Location], list[str]]:
    """The folders that words name as ``key=FOLDER``, and the other words.

    Raises: InputError: one is empty, or a URL that cannot be used.
    """
    from shift3d.store.resolve import as_location

    named, rest = take_words(key, words)
    return [as_location(folder) for folder in named], rest


def runner_of(words: Sequence[str], command: str) -> RunnerConfig:
    """The runner that overrides describe, from what conf/ has, for a command on what a sweep has found.

    Raises: InputError: another setting than the runner's; what was searched is taken as it is.
    """
    from shift3d.settings.compose import compose_sweep
    from shift3d.settings.expand import expand

    for word in words:
        if word.partition("=")[0].split(".")[0] != "runner":
            remedy = "Give settings of the runner alone: runner=local, runner.KEY=VALUE"
            raise InputError(f"cannot read {word!r}", where=command, remedy=remedy)
    return next(iter(expand(compose_sweep("default", words, own=False)))).runner


def _words_of_folder(words: list[str]) -> list[str]:
    """The words that a sweep was begun with where its output folder stands for them; words after it are added.

    A sweep's name is that, whatever the current folder holds: ./NAME is the folder, as is any word with a slash that is
    no file.
    Raises: InputError where out= names another folder, or the folder is no sweep's.
    """
    if not words or "=" in words[0] or words[0] in files("sweeps"):
        return words
    from shift3d.store.resolve import as_location
    from shift3d.sweep.planning.spec_file import read_spec

    folder = as_location(words[0])
    if not (folder / "spec.yaml").is_file() and ("/" not in words[0] or folder.is_file()):
        return words
    if any(word.startswith("out=") and as_location(word.removeprefix("out=")) != folder for word in words[1:]):
        what, remedy = "is a sweep's folder, which is where it goes on", "Leave out= away, or give the sweep's name"
        raise InputError(what, where=str(folder), remedy=remedy)
    spec = read_spec(folder)
    changed = {word.partition("=")[0] for word in words[1:]}
    # Another option of a group takes the settings away that were given for the former option.
    groups = tuple(f"{key}." for key in changed if "." not in key)
    kept = [word for word in spec["overrides"] if word.partition("=")[0] not in changed]
    kept = [word for word in kept if not word.lstrip("+").startswith(groups)]
    return [spec["sweep"], *kept, *words[1:], f"out={folder}"]
