"""A hanging call whose copy came first: its worker is ended like any other, and its tasks are not tried again."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import valid_sweeps
from ray import exceptions

from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray import runner as runner_module
from shift3d.sweep.execution.ray.calls import Call
from shift3d.sweep.execution.ray.runner import RayRunner
from shift3d.sweep.execution.ray.worker_pool import PooledWorker
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.sweep.planning.kind import shift3d_kind


class Ray:
    """Ray that holds results by reference; it ends no other call, answers no question, and starts no worker."""

    exceptions = exceptions

    def __init__(self) -> None:
        self.results: dict[str, BatchOutcome] = {}
        self.killed: list[Any] = []

    def nodes(self) -> list[dict[str, Any]]:
        return [{"Alive": True, "Resources": {"CPU": 2, "memory": 2**36}}]

    def remote(self, **options: Any) -> Any:
        return lambda _: SimpleNamespace(
            remote=lambda *_: SimpleNamespace(ready=SimpleNamespace(remote=lambda: "starting"))
        )

    def put(self, value: object) -> object:
        return value

    def wait(self, references: list[Any], timeout: float, num_returns: int = 1) -> tuple[list[Any], list[Any]]:
        ready = [reference for reference in references if reference in self.results][:num_returns]
        return ready, [reference for reference in references if reference not in ready]

    def get(self, reference: str) -> BatchOutcome:
        return self.results.pop(reference)

    def kill(self, actor: object) -> None:
        self.killed.append(actor)


def test_it_holds_no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    ray = Ray()
    monkeypatch.setattr(runner_module, "connect", lambda config, left: ray)
    config = validate(compose_sweep("smoke", ["runner.task_timeout_s=1", "runner.workers=2"]).base, "test").runner
    assert isinstance(config, RayRunnerConfig)
    runner = RayRunner(shift3d_kind(), valid_sweeps.plan(), config, 2)
    now = time.monotonic()
    hangs = Call("hangs", PooledWorker("hanging"), [0], 1, now - 99, question="question", questioned_at=now - 30)
    copy = Call("copy", PooledWorker("quick"), [0], 2, copy=hangs)
    hangs.copy = copy
    # Keeps the run going after both.
    other = Call("other", PooledWorker("third"), [1], 1)
    for call in (copy, hangs, other):
        runner._calls.add(call)
    ray.results["copy"] = BatchOutcome(done=["a"])
    outcomes = []
    for outcome in runner.run(np.array([], dtype=np.int64), threading.Event()):
        outcomes.append(outcome)
        if len(outcomes) == 3:
            ray.results["other"] = BatchOutcome(done=["b"])
    assert [task for outcome in outcomes for task in outcome.done] == ["a", "b"]
    assert ray.killed == ["hanging"]
    assert not any(outcome.tables for outcome in outcomes), "no attempt has failed"
