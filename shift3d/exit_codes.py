"""Exit codes of the commands: the single list for code and help texts."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["EXIT_CODES", "ExitCode", "exit_codes"]


class ExitCode(IntEnum):
    """Exit code of a command. argparse also exits with 2 for its own errors."""

    DONE = 0
    UNUSABLE = 2
    INCOMPLETE = 3
    TAKEN_OVER = 4
    ABORTED = 5
    WORSE = 6
    INTERRUPTED = 130
    NO_READER = 141


EXIT_CODES = {
    ExitCode.DONE: "done",
    ExitCode.UNUSABLE: "an input of the command cannot be used",
    ExitCode.INCOMPLETE: "done, but tasks were quarantined, no vehicle found a place or a fit is far worse than usual",
    ExitCode.TAKEN_OVER: "another driver took the sweep over",
    ExitCode.ABORTED: "too many tasks failed, and the driver stopped",
    ExitCode.WORSE: "a gate found the weights worse than the last release",
    ExitCode.INTERRUPTED: "interrupted",
    ExitCode.NO_READER: "the reader of the output closed the pipe",
}


def exit_codes() -> str:
    """Return one sentence that explains every exit code."""
    return "exit codes: " + "; ".join(f"{int(code)} {meaning}" for code, meaning in EXIT_CODES.items())
