"""Subcommand description, and parsers for its ``key=value`` words."""

from __future__ import annotations

import argparse
import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from shift3d.cli.completion import folder_words
from shift3d.errors import InputError, empty_error

FINISHED_SWEEP_HELP = "output folder of a finished sweep"
"""Help text of the argument OUT in most commands."""


@dataclass(frozen=True)
class Command:
    """One subcommand, defined in its own file.

    summary: line in ``shift3d --help``. help: text of ``shift3d NAME --help``, normally the docstring of the file: a
    description, then examples. run: function from parsed arguments to an exit code; it imports heavy modules inside.
    out: help of the first argument, a sweep's folder; empty: no folder. words, metavar, complete: help, metavar and
    completer of the words; empty help: no words. options: function that adds further arguments. resumes: True if the
    same command resumes a stopped run.
    """

    name: str
    summary: str
    help: str | None
    run: Callable[[argparse.Namespace], int]
    out: str = ""
    words: str = ""
    metavar: str = "key=value"
    complete: Callable[..., list[str]] | None = None
    options: Callable[[argparse.ArgumentParser], object] | None = None
    resumes: bool = False

    @property
    def description(self) -> str:
        """Part of the help before the arguments."""
        return (self.help or "").partition("\n\nexample")[0]

    @property
    def epilog(self) -> str:
        """Part of the help after the arguments, from the examples on."""
        return (self.help or "").removeprefix(self.description).lstrip()

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments and their completers to a parser."""
        if self.out:
            out = parser.add_argument("out", metavar="OUT", help=self.out)
            out.completer = folder_words  # type: ignore[attr-defined]
        if self.options:
            self.options(parser)
        if self.words:
            words = parser.add_argument("words", nargs="*", default=[], metavar=self.metavar, help=self.words)
            if self.complete:
                words.completer = self.complete  # type: ignore[attr-defined]


def run_command(command: Command, words: Sequence[str]) -> int:
    """Run a command on words of a command line; return its exit code. Raises: InputError, as the command does."""
    parser = argparse.ArgumentParser(prog=f"shift3d {command.name}")
    command.add_arguments(parser)
    return command.run(parser.parse_args(words))


def key_values(words: Sequence[str], known: Sequence[str], required: Sequence[str], where: str) -> dict[str, str]:
    """Parse ``key=value`` words. Raises: InputError: no '=', unknown or repeated key, empty value, or missing key."""
    values: dict[str, str] = {}
    usage = "Give " + " ".join(f"{key}=..." for key in required)
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key not in known:
            keys = ", ".join(f"{name}=" for name in known)
            close = difflib.get_close_matches(key, known, n=1)
            hint = f"Did you mean {close[0]}=? " if equals and close else ""
            raise InputError(f"cannot read {word!r}", where=where, remedy=f"{hint}One of: {keys}")
        if key in values:
            raise InputError(f"{key}= is given twice", where=where, remedy="Give it once")
        if not value.strip():
            raise empty_error(key, where)
        values[key] = value
    for key in required:
        if key not in values:
            raise InputError(f"{key}= is missing", where=where, remedy=usage)
    return values


def pop_values(key: str, words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split words into the values of ``key=VALUE`` and the other words. Raises: InputError: an empty value."""
    named = [word.removeprefix(f"{key}=") for word in words if word.startswith(f"{key}=")]
    if not all(value.strip() for value in named):
        raise empty_error(key)
    return named, [word for word in words if not word.startswith(f"{key}=")]


def choice(values: Mapping[str, str], key: str, allowed: Sequence[str], where: str) -> str:
    """Return the value of a key, by default the first allowed value. Raises: InputError: the value is not allowed."""
    value = values.get(key, allowed[0])
    if value not in allowed:
        raise InputError(f"{key}={value!r} is unknown", where, f"One of: {', '.join(allowed)}")
    return value


def flag(values: Mapping[str, str], key: str, default: bool, where: str) -> bool:
    """Parse the value of a key as true or false. Raises: InputError: any other value."""
    text = values.get(key, str(default).lower())
    if text not in ("true", "false"):
        raise InputError(f"{key}={text!r} is neither true nor false", where, f"Give {key}=true")
    return text == "true"


def refuse(values: Mapping[str, str], keys: Iterable[str], why: str, where: str) -> None:
    """Refuse keys that do not fit the other words. Raises: InputError: the first refused key, with the reason `why`."""
    for key in keys:
        if key in values:
            raise InputError(f"{key}= {why}", where, f"Leave out {key}=")


def whole_number(
    values: Mapping[str, str], key: str, default: int, where: str, least: int = 1, most: float = math.inf
) -> int:
    """Parse the whole number of a key. Raises: InputError: no whole number, or outside `least` to `most`."""
    text = values.get(key, str(default))
    if not text.isdecimal() or not least <= int(text) <= most:
        bounds = f"from {least}" + ("" if math.isinf(most) else f" to {most:.0f}")
        raise InputError(f"{key}={text!r} is not a whole number {bounds}", where, f"Give {key}={default}")
    return int(text)


def share(values: Mapping[str, str], key: str, default: float, where: str) -> float:
    """Parse the number of a key in [0, 1). Raises: InputError: any other value."""
    try:
        value = float(values.get(key, default))
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1.0:
        raise InputError(f"{key}={values[key]!r} is not in [0, 1)", where, f"Give {key}={default:g}")
    return value


def real_number(values: Mapping[str, str], key: str, where: str, example: str) -> float | None:
    """Parse the finite number of a key; None without the key. Raises: InputError: any other value."""
    try:
        value = float(values[key]) if key in values else None
    except ValueError:
        value = math.nan
    if value is not None and not math.isfinite(value):
        raise InputError(f"{key}={values[key]!r} is not a number", where, f"Give {key}={example}")
    return value


def local_path(text: str, key: str = "out") -> Path:
    """Parse a local path and expand ~. key: key of the word. Raises: InputError: a URL, or as `as_location`."""
    from shift3d.store.resolve import as_location

    if "://" in text:
        raise InputError("is no local path, and this command writes to this machine", text, f"Give {key}=PATH")
    return Path(str(as_location(text)))


def writable_folder(text: str, key: str = "out") -> Path:
    """Return an output folder, checked for write access. key: key of the word. Raises: InputError: not writable."""
    from shift3d.store.atomic import check_writable

    folder = local_path(text, key)
    check_writable(folder, f"{key}=DIR")
    return folder
