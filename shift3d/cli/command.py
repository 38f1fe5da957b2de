"""What a subcommand is, and how its ``key=value`` words are read."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from shift3d.errors import InputError, empty_error


@dataclass(frozen=True)
class Command:
    """One subcommand, in its own file.

    summary: a line in ``shift3d --help``. description, epilog: its own ``--help``, the epilog with examples.
    add_arguments: adds to its parser. run: parsed arguments to an exit code; imports heavy things itself. resumes:
    whether the same command goes on where it was stopped.
    """

    name: str
    summary: str
    description: str
    epilog: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    resumes: bool = False


def run_command(command: Command, words: Sequence[str]) -> int:
    """Run a command with words, as a command line would. Raises: InputError as it does."""
    parser = argparse.ArgumentParser(prog=f"shift3d {command.name}")
    command.add_arguments(parser)
    return command.run(parser.parse_args(words))


def key_values(words: Sequence[str], known: Sequence[str], required: Sequence[str], where: str) -> dict[str, str]:
    """Read ``key=value`` words.

    Raises:
        InputError: a word without '=', an unknown, repeated or empty key, or a required one that is missing.
    """
    values: dict[str, str] = {}
    usage = "Give " + " ".join(f"{key}=..." for key in required)
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or key not in known:
            keys = ", ".join(f"{name}=" for name in known)
            raise InputError(f"cannot read {word!r}", where=where, remedy=f"One of: {keys}")
        if key in values:
            raise InputError(f"{key}= is given twice", where=where, remedy="Give it once")
        if not value.strip():
            raise empty_error(key, where)
        values[key] = value
    for key in required:
        if key not in values:
            raise InputError(f"{key}= is missing", where=where, remedy=usage)
    return values


def writable_folder(text: str, key: str = "out") -> Path:
    """The folder that a command writes to, found to be writable before the work begins. key: of the word that names it.

    Raises:
        InputError: it cannot be written to, or made.
    """
    from shift3d.store.atomic import check_writable

    folder = Path(text).expanduser()
    check_writable(folder, f"{key}=DIR")
    return folder
