"""Message to the reader about a call that ended without a result."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import ray.exceptions

import shift3d
from shift3d.sweep.execution.ray.failures import failure_of

RAY = SimpleNamespace(exceptions=ray.exceptions, nodes=lambda: [{"NodeID": "n", "Alive": True}])


def task_error(cause: Exception) -> ray.exceptions.RayTaskError:
    where = "\x1b[36mray::Worker.run()\x1b[39m (pid=7, ip=127.0.0.1)\n  File 'mine.py', line 3\n"
    return ray.exceptions.RayTaskError("run", f"{where}{type(cause).__name__}: {cause}", cause)


def test_what_ray_keeps_private_is_used_in_one_file() -> None:
    package = Path(shift3d.__file__).parent
    users = [file.name for file in package.rglob("*.py") if "ray._private" in file.read_text(encoding="utf-8")]
    assert users == ["connection.py"]


def test_what_the_code_raised_comes_first_and_its_traceback_is_kept() -> None:
    failure = failure_of(RAY, task_error(AttributeError("module 'torch' has no attribute 'x'")), "n")
    assert failure.kind == "crashed"
    assert failure.what == "the worker failed: AttributeError: module 'torch' has no attribute 'x'"
    assert failure.traceback is not None and "\n  File 'mine.py', line 3\n" in failure.traceback
    assert "\x1b" not in failure.traceback


def test_memory_that_runs_out_in_code_is_no_other_failure() -> None:
    failure = failure_of(RAY, task_error(RuntimeError("CUDA out of memory")), "n")
    assert failure.kind == "out_of_memory" and "raise runner.worker_memory_mb" in failure.what[:80]


def test_a_process_that_ends_died() -> None:
    failure = failure_of(RAY, ray.exceptions.ActorDiedError(), "n")
    assert failure.kind == "crashed" and failure.what.startswith("the worker died: ")
