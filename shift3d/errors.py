"""User-facing error of shift3d."""

from __future__ import annotations

from typing import Self

from shift3d.exit_codes import ExitCode


class InputError(Exception):
    """Unusable user input: a wrong setting, file or value.

    The command line prints the error as one line, ``where: what. remedy``, with a non-zero exit code and without a
    traceback. Any other exception that reaches the user is a defect of shift3d.

    what: the problem, with the offending value. where: file, field or row of the problem. remedy: the next action.
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
        # Ray pickles exceptions between processes. The default reduction would lose the three parts.
        return (type(self), (self.what, self.where, self.remedy))


def empty_error(key: str, where: str = "") -> InputError:
    """Return the error for ``key=`` without a value, as an unset shell variable leaves it."""
    remedy = f"Give {key}=..., or no {key}= at all; is a variable of the shell unset?"
    return InputError(f"{key}= is empty", where=where, remedy=remedy)


def _one_line(text: str) -> str:
    """Replace control characters by spaces: messages quote the content of damaged files, which may break a terminal."""
    return "".join(letter if letter.isprintable() else " " for letter in text)
