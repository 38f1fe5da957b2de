"""Pool of Ray workers: how many fit, and which are starting, idle, busy or lost."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shift3d.errors import InputError
from shift3d.processor import mixed_processors
from shift3d.progress_bar import write_line
from shift3d.settings.schema.config import RayRunnerConfig
from shift3d.sweep.execution.ray.connection import node_of
from shift3d.sweep.execution.ray.excluded_machines import MAX_FAILED_STARTS, ExcludedMachines
from shift3d.sweep.execution.ray.failures import names_lost_machine
from shift3d.sweep.execution.ray.versions import installed_versions, version_mismatch
from shift3d.sweep.execution.ray.worker import WorkerAddress

# Interval between queries of the cluster's size: machines join and leave within minutes.
_LOOK_S = 2.0
# A cluster without a ready worker after this time is reported: it may lack room, or be adding machines.
_PATIENCE_S = 30.0
_RAISED = re.compile(r"[\w.]*(Error|Exception)\b")


def worker_capacity(nodes: list[dict[str, Any]], cpus: float, memory_mb: float, estimated: bool = True) -> int:
    """Return the number of workers that fit on the live machines, by CPUs and memory.

    estimated: memory_mb is an estimate, and trying is better than refusing: if no machine has the memory, one worker is
    still allowed on a machine with the CPUs. If the settings state the memory, Ray itself reserves it.
    """
    alive = [node["Resources"] for node in nodes if node["Alive"]]
    # Ray counts ten-thousandths of a CPU; 2 // 0.1 is 19.
    by_cpu: list[int] = [round(1e4 * resources.get("CPU", 0)) // round(1e4 * cpus) for resources in alive]
    by_memory = [int(resources.get("memory", 0) // (memory_mb * 2**20)) for resources in alive]
    return max(sum(map(min, by_cpu, by_memory)), min(1, sum(by_cpu)) if estimated else 0)


def _reason(text: str) -> str:
    """Return the reason of a failed start: the last exception of Python if Ray's text ends with one."""
    last = text.strip().rpartition("\n")[2]
    return last[:600] if _RAISED.match(last) else " ".join(text.split())[-600:]


@dataclass
class PooledWorker:
    """Worker of the pool. where: its process and machine, None until it is ready. running: True if it has a call."""

    actor: Any
    where: WorkerAddress | None = None
    running: bool = False

    @property
    def process(self) -> str:
        """Host and process id."""
        return self.where.process if self.where else "starting"

    @property
    def host(self) -> str:
        """Name of the worker's machine."""
        return self.process.rpartition(":")[0]

    @property
    def node_id(self) -> str:
        """Ray's id of the worker's machine."""
        return self.where.node_id if self.where else ""


class WorkerPool:
    """Workers of a run, from start to end.

    Args:
        start: starts an actor with further options of Ray. config: number of workers (None: as many as fit) and their
            size. most: maximum number.

    Attributes:
        wanted: current target number of workers. left_out: machines that get no more workers.

    Raises: InputError: there is no room for a worker, and nothing could make room.
    """

    def __init__(self, ray: Any, start: Callable[..., Any], config: RayRunnerConfig, memory_mb: float, most: int):
        self._ray = ray
        self._start = start
        self._config = config
        self._memory_mb = memory_mb
        self._most = most
        self._starting: dict[Any, PooledWorker] = {}
        self._workers: list[PooledWorker] = []
        self._processors: dict[str, str] = {}
        self._failed = 0
        self._looked = 0.0
        self.left_out = ExcludedMachines(ray, config.cpus_per_worker)
        self._report_at = time.monotonic() + _PATIENCE_S
        self.wanted = self._room()
        if self.wanted < 1:
            settings = "runner.cpus_per_worker" + (" or runner.worker_memory_mb" if config.worker_memory_mb else "")
            what = f"Ray has no room for a worker of {self._demand()}"
            raise InputError(what, where="runner", remedy=f"Lower {settings}, or use runner=local")

    def _room(self) -> int:
        config = self._config
        room = worker_capacity(
            self.left_out.others(), config.cpus_per_worker, self._memory_mb, not config.worker_memory_mb
        )
        # An autoscaling cluster grows only if workers wait for room, so all requested workers are started.
        wanted = config.workers if config.workers and (room or config.address) else room
        return min(wanted, self._most)

    def _demand(self) -> str:
        memory = f" and {self._memory_mb:g} MB" if self._config.worker_memory_mb else ""
        return f"{self._config.cpus_per_worker:g} CPUs{memory}"

    def _report_waiting(self, now: float) -> None:
        """Print one line if no worker is ready after a while, at the start or after the loss of the last one: a cluster
        without room looks like a slow one."""
        if self._workers:
            self._report_at = now + _PATIENCE_S
        elif self._config.address and self._starting and now >= self._report_at:
            self._report_at = float("inf")
            write_line(
                f"no worker is ready after {_PATIENCE_S:.0f} s: the cluster has no room for one of {self._demand()} "
                "(runner.cpus_per_worker, runner.worker_memory_mb), or its machines are starting, lost or left out"
            )

    @property
    def starting(self) -> list[Any]:
        """References that are ready when a worker is."""
        return list(self._starting)

    def grow(self, tasks: int) -> None:
        """Start missing workers. tasks: waiting or in flight; more workers than tasks would idle."""
        now = time.monotonic()
        if now - self._looked >= _LOOK_S:
            self._looked = now
            self.wanted = max(self._room(), 1)
        self._report_waiting(now)
        # After a failed start, workers start one at a time.
        at_once = 1 if self._failed else self.wanted
        missing = min(self.wanted, tasks) - len(self._workers) - len(self._starting)
        for _ in range(min(missing, at_once - (len(self._starting) if self._failed else 0))):
            actor = self._start(**self.left_out.options())
            self._starting[actor.ready.remote()] = PooledWorker(actor)

    def started(self, reference: Any) -> InputError | None:
        """Handle an ended start: the worker is idle, or was lost. Return an error if no worker can be started at all.

        A start that failed because its machine was lost does not count.
        """
        worker = self._starting.pop(reference)
        try:
            where: WorkerAddress = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            if names_lost_machine(self._ray, error):
                return None
            self._failed += 1
            return self._failed_start(worker, _reason(str(error)))
        worker.where = where
        if worker.node_id in self.left_out:  # the start preceded the exclusion
            self._ray.kill(worker.actor)
            return None
        here = installed_versions()
        if other := version_mismatch(where.versions or here, here):
            self.left_out.add(worker.node_id, worker.host, other)
            self._ray.kill(worker.actor)
            nobody = not self._workers and not self.left_out.any_other()
            return InputError(other.what, worker.host, other.remedy) if nobody else None
        self._failed = 0
        self.left_out.started(worker.node_id)
        self._workers.append(worker)
        self._note_processor(worker.host, where.instructions)
        return None

    def _note_processor(self, host: str, instructions: str) -> None:
        """Print one line for each kind of processor after the first."""
        if self._processors and instructions not in self._processors:
            other, first = next(iter(self._processors.items()))
            write_line(mixed_processors(f"{host} computes with {instructions}", f"{first} with {other}"))
        self._processors.setdefault(instructions, host)

    def _failed_start(self, worker: PooledWorker, why: str) -> InputError | None:
        remedy = "Install this shift3d on every machine"
        node_id, host = node_of(self._ray, worker.actor)
        held = any(other.node_id == node_id for other in self._workers)
        if node_id and not held and self.left_out.failed_start(node_id):
            self.left_out.add(node_id, host, InputError(f"no worker starts there: {why}", remedy=remedy))
        if self._failed < MAX_FAILED_STARTS or self._workers or (node_id and self.left_out.any_other()):
            return None
        return InputError(f"no worker starts: {why}", where="runner", remedy=remedy)

    def leave(self, node_id: str, host: str, error: InputError) -> None:
        """Leave a machine out, and end its workers without a call; `RayRunner` ends the others after their call."""
        self.left_out.add(node_id, host, error)
        for worker in [other for other in self._workers if other.node_id == node_id and not other.running]:
            self.lost(worker)

    def idle(self) -> PooledWorker | None:
        """Return a worker without a call, or None. If the worker has died, its next call fails."""
        return next((worker for worker in self._workers if not worker.running), None)

    def lost(self, worker: PooledWorker) -> None:
        """Remove a worker that is dead or unusable, and kill its actor."""
        if worker in self._workers:
            self._workers.remove(worker)
        self._ray.kill(worker.actor)
