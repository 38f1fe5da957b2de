"""The one error that a user of shift3d is meant to read."""

from __future__ import annotations

from typing import Self

from shift3d.exit_codes import ExitCode


class InputError(Exception):
    """Something the user gave cannot be used.

    Printed by the command line as one line, ``what (where): remedy``, with a non-zero exit code and without a
    traceback; anything else that escapes is a defect of shift3d.

    Args:
        what: what is wrong, with the offending value.
        where: the file, field or row it was found in.
        remedy: what to do about it.
    """

    exit_code = ExitCode.UNUSABLE

    def __init__(self, what: str, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        message = f"{where}: {what}" if where else what
        end = "" if message.endswith((".", "!", "?")) else "."
        super().__init__(_one_line(f"{message}{end} {remedy}" if remedy else message))

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, str]]:
        # Ray carries exceptions between processes: without this the three parts would be lost on the way.
        return (type(self), (self.what, self.where, self.remedy))


def empty_error(key: str, where: str = "") -> InputError:
    """The error for ``key=`` with nothing after it: what an unset variable of the shell leaves of a word."""
    remedy = f"Give {key}=..., or no {key}= at all; is a variable of the shell unset?"
    return InputError(f"{key}= is empty", where=where, remedy=remedy)


def _one_line(text: str) -> str:
    """The text without what breaks a line or a terminal: readers quote what they found in a damaged file."""
    return "".join(letter if letter.isprintable() else " " for letter in text)
