"""Closing messages common to commands: an interruption, and the result of mirroring to MLflow."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from shift3d.exit_codes import ExitCode
from shift3d.wording import counted

if TYPE_CHECKING:
    from shift3d.settings.schema.config import MlflowConfig, NoTrackingConfig
    from shift3d.sweep.drive import SweepResult

DEFAULT_STORE = "sqlite:///mlflow.db"
"""MLflow store that ``shift3d ui`` shows unless another one is named."""


def interrupted(result: SweepResult, what: str = "done", command: str = "") -> int:
    """Print an interrupted sweep's progress and how to resume; return the exit code. what: as in "3 tasks verified"."""
    print(
        f"interrupted: {result.done} of {counted(result.planned, 'task')} {what}, {result.left} left", file=sys.stderr
    )
    print("the same command resumes" + (f": {command}" if command else ""), file=sys.stderr)
    return int(ExitCode.INTERRUPTED)


def mirror(tracking: MlflowConfig | NoTrackingConfig, write: Callable[[str, str], str | None], run: str = "") -> None:
    """Mirror results to the MLflow store of the settings, if any, and print the outcome.

    write: writes the run, given URI and experiment of the store; returns the problem, or None. run: name of the run.
    """
    from shift3d.settings.schema.config import MlflowConfig

    if not isinstance(tracking, MlflowConfig):
        return
    if problem := write(tracking.uri, tracking.experiment):
        print(f"warning: not in MLflow ({tracking.uri}): {problem}", file=sys.stderr)
        print("the same command writes the run once MLflow answers", file=sys.stderr)
    else:
        store = "" if tracking.uri == DEFAULT_STORE else f" --uri {shlex.quote(tracking.uri)}"
        shown = "" if tracking.uri.startswith("http") else f"; shift3d ui{store} shows it"
        print(f"MLflow run {f'{run} ' if run else ''}in {tracking.uri}{shown}")
