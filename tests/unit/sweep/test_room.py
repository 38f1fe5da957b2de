"""As many workers as fit by CPU and by memory, machine by machine."""

from __future__ import annotations

import os
from typing import Any

import pytest

from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray import connection
from shift3d.sweep.execution.ray.worker_pool import room_for


def config(*overrides: str) -> RayRunnerConfig:
    runner = validate(compose_sweep("smoke", list(overrides)).base, "test").runner
    assert isinstance(runner, RayRunnerConfig)
    return runner


def node(cpus: float, memory_gb: float, alive: bool = True) -> dict[str, Any]:
    return {"Alive": alive, "Resources": {"CPU": cpus, "memory": memory_gb * 2**30}}


def test_the_scarcer_of_the_two_decides_on_each_machine() -> None:
    assert room_for([node(8, 2), node(2, 64)], cpus=1, memory_mb=1024) == 2 + 2


def test_machines_that_are_gone_hold_none() -> None:
    assert room_for([node(8, 64, alive=False), node(2, 64)], cpus=1, memory_mb=1024) == 2


def test_one_worker_is_tried_where_memory_seems_too_little_for_any() -> None:
    assert room_for([node(4, 0.5), node(4, 0.5)], cpus=1, memory_mb=1024) == 1


def test_no_cpus_no_worker() -> None:
    assert room_for([node(0, 64), node(0.5, 64)], cpus=1, memory_mb=1024) == 0


def test_a_private_ray_has_the_cpus_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    found: list[int] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(os, "environ", dict(os.environ))
    monkeypatch.setattr(connection, "require_token", lambda private: True)
    monkeypatch.setattr(connection, "_end_idle_helpers", lambda ray: None)
    monkeypatch.setattr(ray, "init", lambda **options: found.append(options["num_cpus"]))
    connection.connect(config(), tasks_left=100)
    connection.connect(config("runner.workers=3"), tasks_left=100)
    assert found == [1, 3]
