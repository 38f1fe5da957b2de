"""Words after ``shift3d sweep`` and ``shift3d plan``: a sweep or its folder, overrides, folders, and the job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from shift3d.cli.command import pop_values
from shift3d.cli.completion import runner_words
from shift3d.errors import InputError
from shift3d.settings.folders import files

if TYPE_CHECKING:
    from shift3d.cli.job_spec import JobSpec
    from shift3d.settings.schema.config import RunnerConfig
    from shift3d.store.location import Location


SWEEP_WORDS = "name of the sweep, overrides, out=DIR (output folder), job=NAME (launch spec: where the sweep runs)"
SWEEP_METAVAR = "NAME | key=value"
RUNNER_ARGUMENT = ("settings of conf/runner: where the tasks run", "runner=...", runner_words)
"""Help, metavar and completer of words that :func:`compose_runner` parses."""


@dataclass(frozen=True)
class SweepRequest:
    """Parsed words of a command line.

    out: output folder; None: the default one. reuse: folders of other sweeps, whose results of the same tasks are
    reused. job: launch spec; `overrides` already include its runner.
    """

    name: str
    overrides: list[str]
    out: Location | None
    reuse: list[Location]
    job: JobSpec | None


def read_words(words: Sequence[str]) -> SweepRequest:
    """Parse the words of a command line. Raises: InputError: an unusable or damaged folder, or an unknown job."""
    from shift3d.cli.job_spec import pop_job
    from shift3d.sweep.planning.spec_file import read_spec, refuse_follow_up

    reuse, rest = pop_folders("reuse", words)
    for folder in reuse:
        refuse_follow_up(read_spec(folder), folder)  # checked before the scenes are read, which may take minutes
    job, typed = pop_job(rest)
    name, overrides, out = parse_name_and_overrides(_words_of_folder(typed))
    if job:
        # The job's runner replaces the runner that the sweep's folder recorded.
        overrides = [word for word in overrides if word in typed or not word.startswith("runner")]
        overrides = [*job.overrides(overrides), *overrides]
    return SweepRequest(name, overrides, out, reuse, job)


def parse_name_and_overrides(words: Sequence[str]) -> tuple[str, list[str], Location | None]:
    """Split words into (name, overrides, out). Raises: InputError: out= is empty or an unusable URL."""
    name = "default"
    if words and "=" not in words[0] and not words[0].startswith(("+", "~")):
        name, words = words[0], words[1:]
    out, rest = pop_folders("out", words)
    return name, rest, out[-1] if out else None


def pop_folders(key: str, words: Sequence[str]) -> tuple[list[Location], list[str]]:
    """Split words into folders of ``key=FOLDER`` and other words. Raises: InputError: an empty or unusable folder."""
    from shift3d.store.resolve import as_location

    named, rest = pop_values(key, words)
    return [as_location(folder) for folder in named], rest


def compose_runner(words: Sequence[str], command: str) -> RunnerConfig:
    """Compose the runner from conf/ and overrides, for a follow-up command. Raises: InputError: any other override."""
    from shift3d.settings.compose import compose_sweep
    from shift3d.settings.expand import expand

    for word in words:
        if word.partition("=")[0].split(".")[0] != "runner":
            remedy = "Give settings of the runner alone: runner=local, runner.KEY=VALUE"
            raise InputError(f"cannot read {word!r}", where=command, remedy=remedy)
    return next(iter(expand(compose_sweep("default", words, own=False)))).runner


def _words_of_folder(words: list[str]) -> list[str]:
    """Replace a sweep's output folder as the first word by the words that began the sweep; later words are added.

    The name of a sweep is never read as a folder; ./NAME is a folder, and so is any word with a slash that is no file.
    Raises: InputError: out= names another folder, or the folder is not a sweep's.
    """
    if not words or "=" in words[0] or words[0] in files("sweeps"):
        return words
    from shift3d.store.resolve import as_location
    from shift3d.sweep.planning.spec_file import read_spec

    folder = as_location(words[0])
    if not (folder / "spec.yaml").is_file() and ("/" not in words[0] or folder.is_file()):
        return words
    if any(word.startswith("out=") and as_location(word.removeprefix("out=")) != folder for word in words[1:]):
        what, remedy = "is a sweep's folder, and the sweep resumes there", "Leave out= away, or give the sweep's name"
        raise InputError(what, where=str(folder), remedy=remedy)
    spec = read_spec(folder)
    changed = {word.partition("=")[0] for word in words[1:]}
    # A different option of a group drops the recorded settings of the former option.
    groups = tuple(f"{key}." for key in changed if "." not in key)
    kept = [word for word in spec["overrides"] if word.partition("=")[0] not in changed]
    kept = [word for word in kept if not word.lstrip("+").startswith(groups)]
    return [spec["sweep"], *kept, *words[1:], f"out={folder}"]
