"""Room for workers by CPUs and by memory, machine by machine."""

from __future__ import annotations

import os
import time
from types import SimpleNamespace
from typing import Any

import pytest

from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray import connection
from shift3d.sweep.execution.ray.worker_pool import PooledWorker, WorkerPool, worker_capacity


def config(*overrides: str) -> RayRunnerConfig:
    runner = validate(compose_sweep("smoke", list(overrides)).base, "test").runner
    assert isinstance(runner, RayRunnerConfig)
    return runner


def node(cpus: float, memory_gb: float, alive: bool = True) -> dict[str, Any]:
    return {"Alive": alive, "Resources": {"CPU": cpus, "memory": memory_gb * 2**30}}


def test_the_scarcer_of_the_two_decides_on_each_machine() -> None:
    assert worker_capacity([node(8, 2), node(2, 64)], cpus=1, memory_mb=1024) == 2 + 2


def pool(nodes: list[dict[str, Any]], *overrides: str) -> WorkerPool:
    """Return the pool for 100 tasks known to need 300 MB, on a Ray of these machines where no start ends."""
    actor = SimpleNamespace(ready=SimpleNamespace(remote=object), _actor_id=b"")
    runner = config(*overrides)
    ray = SimpleNamespace(nodes=lambda: nodes)
    return WorkerPool(ray, lambda: actor, runner, runner.worker_memory_mb or 300, 100)


def test_machines_that_are_gone_hold_none() -> None:
    assert worker_capacity([node(8, 64, alive=False), node(2, 64)], cpus=1, memory_mb=1024) == 2


def test_one_worker_is_tried_where_memory_seems_too_little_for_any() -> None:
    assert worker_capacity([node(4, 0.5), node(4, 0.5)], cpus=1, memory_mb=1024) == 1


def test_memory_that_the_settings_state_is_no_estimate() -> None:
    assert worker_capacity([node(4, 0.5), node(4, 0.5)], cpus=1, memory_mb=1024, estimated=False) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("runner.worker_memory_mb=100000",), "CPUs and 100000 MB.*Lower .* or runner.worker_memory_mb"),
        (("runner.worker_memory_mb=100000", "runner.workers=1"), "CPUs and 100000 MB"),
        (("runner.cpus_per_worker=8", "runner.workers=4"), "8 CPUs. Lower runner.cpus_per_worker, or"),
    ],
)
def test_a_private_ray_without_room_is_refused(words: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=f"runner: Ray has no room for a worker of .*{message}"):
        pool([node(4, 16)] * 3, *words)
    assert pool([node(4, 0.1)], "runner.workers=2").wanted == 2, "an estimate refuses nothing"


def test_a_cluster_without_room_may_grow_and_says_once_that_nothing_starts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("runner.address=auto", "runner.workers=4", "runner.worker_memory_mb=100000")
    found = pool([node(4, 16)], *words)
    found.grow(100)
    assert (len(found.starting), capsys.readouterr().err) == (4, "")
    later = time.monotonic() + 31
    monkeypatch.setattr(time, "monotonic", lambda: later)
    found.grow(100)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("no worker is ready after 30 s") and "1 CPUs and 100000 MB" in line
    found.grow(100)
    assert capsys.readouterr().err == ""
    found._workers.append(PooledWorker(object()))
    found.grow(100)
    found._workers.clear()
    found.grow(100)
    assert capsys.readouterr().err == ""
    later += 31
    found.grow(100)
    assert "no worker is ready after 30 s" in capsys.readouterr().err, "the last one was lost"


NODE_DIED = "The actor died because its node has died. Node Id: 0a1b."


@pytest.mark.parametrize(("text", "fatal"), [(NODE_DIED, False), ("The actor died: no module named shift3d", True)])
def test_starts_fail_by_a_defect_or_because_their_machine_went_away(text: str, fatal: bool) -> None:
    """All three workers of a machine are starting when it goes away."""
    from ray import exceptions
    from ray.core.generated.common_pb2 import ActorDiedErrorContext

    def get(reference: object) -> object:
        raise exceptions.ActorDiedError(ActorDiedErrorContext(error_message=text, actor_id=b"0" * 16))

    found = pool([node(4, 16)], "runner.workers=3", "runner.address=auto")
    state = SimpleNamespace(state=SimpleNamespace(actors=lambda _: {}))
    found._ray = SimpleNamespace(get=get, exceptions=exceptions, nodes=lambda: [node(4, 16)], _private=state)
    found.grow(100)
    ends = [found.started(reference) for reference in found.starting]
    assert len(ends) == 3 and ends[:2] == [None, None]
    assert (ends[2] is not None) == fatal


@pytest.mark.parametrize(
    ("share", "workers"), [(0.1, 20), (0.2, 10), (0.05, 40), (0.3, 6), (0.66667, 2), (1e-4, 20_000)]
)
def test_workers_share_a_cpu_in_the_parts_that_ray_counts(share: float, workers: int) -> None:
    assert worker_capacity([node(2, 10_000)], cpus=share, memory_mb=1) == workers
    runner = config(f"runner.cpus_per_worker={share}")
    assert isinstance(runner, RayRunnerConfig) and runner.workers_on(2) == workers


def test_no_cpus_no_worker() -> None:
    assert worker_capacity([node(0, 64), node(0.5, 64)], cpus=1, memory_mb=1024) == 0


def test_a_private_ray_has_the_cpus_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    import ray

    found: list[int] = []
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    monkeypatch.setattr(os, "environ", dict(os.environ))
    monkeypatch.setattr(connection, "require_token", lambda private: True)
    monkeypatch.setattr(ray, "init", lambda **options: found.append(options["num_cpus"]))
    connection.connect(config(), tasks_left=100)
    connection.connect(config("runner.workers=3"), tasks_left=100)
    assert found == [1, 3]
    monkeypatch.setattr(connection, "usable_cpus", lambda: 5)
    for cpus, room in ((2, 4), (0.5, 5), (8, 8)):  # two workers, ten, and one that is tried anyway
        connection.connect(config(f"runner.cpus_per_worker={cpus}"), tasks_left=100)
        assert found[-1] == room
