"""Ray actor of a worker: it holds the tasks of a plan, runs them by position, and keeps a status file."""

from __future__ import annotations

import dataclasses
import os
import socket
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from shift3d.errors import InputError
from shift3d.sweep.execution.ray.shipped_files import ShippedFiles, with_local_files
from shift3d.sweep.execution.ray.versions import installed_versions
from shift3d.sweep.execution.ray.worker_status import WorkerStatusFile
from shift3d.sweep.execution.worker import BatchOutcome, Worker
from shift3d.sweep.planning.kind import TaskKind
from shift3d.sweep.planning.tasks import PlannedTask
from shift3d.task.exchange import AssetsSpec


def _load(load: Callable[[AssetsSpec], Any], spec: AssetsSpec, shipped: ShippedFiles) -> Any:
    """Load the assets from this machine's files.

    Raises: InputError: any failure, since a library that is damaged is a defect of this machine, not of a task.
    """
    try:
        return load(with_local_files(spec, shipped))
    except InputError:
        raise
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        what = f"cannot load what tasks need: {type(error).__name__}: {error}"
        raise InputError(what, f"{last.filename}:{last.lineno}", "Repair shift3d or the file there") from error


@dataclass(frozen=True)
class WorkerAddress:
    """Address of a ready worker. node_id: Ray's. process: host and process id. status_path: status file of `pid`.

    versions: installed on its machine; None: the driver's. instructions: see `TaskKind`.
    """

    node_id: str
    process: str
    pid: int
    status_path: str
    versions: Mapping[str, str] | None = None
    instructions: str = ""


class RayWorker:
    """Ray actor with the arguments of `Worker`. tasks: of the whole plan. shipped: files that this machine may lack.

    Tasks, assets and shipped come from Ray's object store, which holds them once per machine.
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
        # The first task loads the assets, since its outcome can report in one line why that failed.
        load = kind.load
        kind = dataclasses.replace(kind, load=lambda spec: _load(load, spec, shipped))
        self._instructions = kind.instructions
        self._status_file = WorkerStatusFile()
        self._worker = Worker(kind, sweep, assets, command, self._status_file.note)

    def ready(self) -> WorkerAddress:
        """Return the address as soon as this process is ready."""
        import ray

        pid = os.getpid()
        node_id = ray.get_runtime_context().get_node_id()
        process = f"{socket.gethostname()}:{pid}"
        versions, instructions = installed_versions(), self._instructions()
        return WorkerAddress(node_id, process, pid, self._status_file.path, versions, instructions)

    def run(self, positions: Sequence[int], first_attempt: int) -> BatchOutcome:
        """See `Worker.run_batch`."""
        tasks = [self._tasks[position] for position in positions]
        return self._worker.run_batch(tasks, first_attempt=first_attempt)
