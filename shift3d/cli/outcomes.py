"""What commands say at their end in common: that they were interrupted, and what became of the MLflow run."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from shift3d.exit_codes import ExitCode
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.settings.schema.config import MlflowConfig, NoTrackingConfig
    from shift3d.sweep.drive import SweepResult


def interrupted(result: SweepResult, what: str = "done", command: str = "") -> int:
    """Say how far an interrupted sweep is, and that its command resumes; the exit code. what: was done to the tasks."""
    print(
        f"interrupted: {result.done} of {counted(result.planned, 'task')} {what}, {result.left} left", file=sys.stderr
    )
    print("the same command resumes" + (f": {command}" if command else ""), file=sys.stderr)
    return int(ExitCode.INTERRUPTED)


def mirror(tracking: MlflowConfig | NoTrackingConfig, write: Callable[[str, str], str | None], run: str = "") -> None:
    """Mirror to the store that settings name, if they name one, and say what came of it.

    write: of the store's URI and the experiment, returns why MLflow could not be written. run: its name, if it has one.
    """
    from shift3d.settings.schema.config import MlflowConfig

    if not isinstance(tracking, MlflowConfig):
        return
    if problem := write(tracking.uri, tracking.experiment):
        print(f"warning: not in MLflow ({tracking.uri}): {problem}", file=sys.stderr)
        print("the same command again writes it there once MLflow answers", file=sys.stderr)
    else:
        print(f"{f'MLflow run {run} in' if run else 'in MLflow,'} {tracking.uri}: shift3d ui")
