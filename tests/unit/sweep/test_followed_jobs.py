"""A sweep handed to Ray's Jobs API and lost from sight: one line that starts no second driver."""

from __future__ import annotations

from collections.abc import AsyncIterator
from types import SimpleNamespace

import pytest
import requests

from shift3d.errors import InputError
from shift3d.sweep.execution.ray import job


class TunnelLost:
    """Ray's client behind a tunnel that breaks."""

    async def tail_job_logs(self, name: str) -> AsyncIterator[str]:
        """Yield a line, then raise Ray's error."""
        yield "task 1 of 9\n"
        raise RuntimeError("WebSocket connection closed unexpectedly with close code 1006")

    def get_job_info(self, name: str) -> SimpleNamespace:
        """Raise as if nobody answers."""
        raise requests.exceptions.ConnectionError("refused")


class DashboardGone(TunnelLost):
    """The log ends, and nobody answers afterwards."""

    async def tail_job_logs(self, name: str) -> AsyncIterator[str]:
        """Yield a line."""
        yield "task 1 of 9\n"


class StillRunning(DashboardGone):
    """The log ends before the job does."""

    def get_job_info(self, name: str) -> SimpleNamespace:
        """Return a job that is still running."""
        return SimpleNamespace(status="RUNNING", driver_exit_code=None, message="Job is currently running.")


@pytest.mark.parametrize("client", [TunnelLost, DashboardGone, StillRunning])
def test_the_sweep_is_left_to_go_on(client: type[TunnelLost], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("RAY_AUTH_TOKEN", "0" * 64)
    monkeypatch.setattr(job, "_submit", lambda *_: (client(), "raysubmit_1"))
    with pytest.raises(
        InputError, match=r"raysubmit_1 cannot be followed any more .*Follow the sweep, which goes on: ray job"
    ):
        job.submit_sweep(["smoke", "out=/shared/x"], "http://127.0.0.1:1", None)
