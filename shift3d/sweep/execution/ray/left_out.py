"""Machines that cannot run a sweep's tasks: no worker is started there any more, and a line of each says why.

A machine is left out where a worker could not load what tasks need (its data are not mounted, its disk is full), where
tasks of several scenes in a row could not read or write a file, where several starts of workers failed, or where other
versions are installed. One that is started again counts as another.

Source: our choice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from shift3d.errors import InputError
from shift3d.progress_bar import write_line

# Starts that fail on a machine: a defect of its installation.
FAILED_STARTS = 3
# Scenes in a row that a machine cannot read or write: one or two may themselves be damaged.
UNREAD_SCENES = 3
_NODE_ID = "ray.io/node-id"


class LeftOut:
    """Which machines are left out. cpus: of a worker.

    Attributes:
        lines: one a machine, in the order in which they were left out.
    """

    def __init__(self, ray: Any, cpus: float) -> None:
        self._ray = ray
        self._cpus = cpus
        self._ids: set[str] = set()
        self._failed: Counter[str] = Counter()
        self._unread: dict[str, set[str]] = {}
        self._shown = 0
        self.lines: list[str] = []

    def __contains__(self, node_id: str) -> bool:
        return node_id in self._ids

    def add(self, node_id: str, host: str, error: InputError) -> str:
        """Leave a machine out. The line that says so."""
        line = f"{host} is left out: {error}"
        if node_id not in self._ids:
            self._ids.add(node_id)
            self.lines.append(line)
        return line

    def failed_start(self, node_id: str) -> bool:
        """Count a start that failed on a machine. Whether these were too many."""
        self._failed[node_id] += 1
        return self._failed[node_id] >= FAILED_STARTS

    def started(self, node_id: str) -> None:
        """A start on a machine went well: earlier ones that failed are forgotten."""
        del self._failed[node_id]

    def unread(self, node_id: str, scenes: set[str], done: bool) -> bool:
        """Count the scenes of tasks that a machine's file system or network failed. Whether these were too many.

        done: it finished others meanwhile, and earlier ones are forgotten.
        """
        self._unread[node_id] = scenes | (set() if done else self._unread.get(node_id, set()))
        return len(self._unread[node_id]) >= UNREAD_SCENES

    def show(self) -> None:
        """Print the lines that are new, once others run tasks: where none does, the sweep's own error says it."""
        for line in self.lines[self._shown :]:
            write_line(line)
        self._shown = len(self.lines)

    def others(self) -> list[dict[str, Any]]:
        """Machines that are there and not left out, as Ray describes them."""
        return [node for node in self._ray.nodes() if node["Alive"] and node.get("NodeID") not in self._ids]

    def any_other(self, than: str = "") -> bool:
        """Whether a machine that is not left out has the CPUs for a worker. than: a machine that does not count."""
        others = (node["Resources"] for node in self.others() if node.get("NodeID") != than)
        return any(resources.get("CPU", 0) >= self._cpus for resources in others)

    def options(self) -> Mapping[str, Any]:
        """Of an actor, so that it is started elsewhere."""
        return {"label_selector": {_NODE_ID: f"!in({','.join(sorted(self._ids))})"}} if self._ids else {}
