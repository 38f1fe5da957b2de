"""A worker as Ray runs it: given positions of a plan that it holds, and keeping a logbook of what it is at."""

from __future__ import annotations

import dataclasses
import os
import socket
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from shift3d.errors import InputError
from shift3d.sweep.execution.ray.logbook import Logbook
from shift3d.sweep.execution.ray.shipped_files import ShippedFiles, unloaded
from shift3d.sweep.execution.ray.versions import installed
from shift3d.sweep.execution.worker import BatchOutcome, Worker
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.task.exchange import AssetsSpec


def _load(load: Callable[[AssetsSpec], Any], spec: AssetsSpec, shipped: ShippedFiles) -> Any:
    """What tasks need, loaded from this machine's files.

    Raises: InputError: whatever it is that fails: a library that is damaged here is this machine's defect, no task's.
    """
    try:
        return load(unloaded(spec, shipped))
    except InputError:
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"cannot load what tasks need: {type(error).__name__}: {error}"
        raise InputError(what, f"{last.filename}:{last.lineno}", "Repair shift3d or the file there") from error


@dataclass(frozen=True)
class Ready:
    """Where a worker runs. node_id: Ray's. process: host and process id. logbook: of its process `pid`.

    versions: of what its machine has installed; None: the driver's.
    """

    node_id: str
    process: str
    pid: int
    logbook: str
    versions: Mapping[str, str] | None = None


class RayWorker:
    """Arguments as of `Worker`; tasks: of the whole plan; shipped: files that this machine may not have.

    Tasks, assets and shipped come from Ray's object store, where a machine has them once.
    """

    def __init__(
        self,
        kind: TaskKind,
        sweep: str,
        assets: Sequence[AssetsSpec],
        tasks: Sequence[PlannedTask],
        command: str,
        shipped: ShippedFiles,
    ) -> None:
        self._tasks = tasks
        # With the first task, whose outcome can say in one line why nothing could be loaded.
        load = kind.load
        kind = dataclasses.replace(kind, load=lambda spec: _load(load, spec, shipped))
        self._logbook = Logbook()
        self._worker = Worker(kind, sweep, assets, command, self._logbook.note)

    def ready(self) -> Ready:
        """Answered as soon as this process is ready."""
        import ray

        pid = os.getpid()
        node_id = ray.get_runtime_context().get_node_id()
        return Ready(node_id, f"{socket.gethostname()}:{pid}", pid, self._logbook.path, installed())

    def run(self, positions: Sequence[int], first_attempt: int) -> BatchOutcome:
        """See `Worker.run_batch`."""
        tasks = [self._tasks[position] for position in positions]
        return self._worker.run_batch(tasks, first_attempt=first_attempt)
