"""Machines that cannot run a sweep's tasks: no more workers are started on them, and one line each says why.

A machine is left out if a worker could not load the assets (data not mounted, disk full), if tasks of several scenes in
a row could not read or write a file, if several worker starts failed, or if other versions are installed. A restarted
machine counts as a new one.

Source: our choice.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from shift3d.errors import InputError
from shift3d.progress_bar import write_line

# Failed starts on one machine that show a defect of its installation.
MAX_FAILED_STARTS = 3
# Scenes in a row that a machine cannot read or write; one or two may themselves be damaged.
MAX_UNREADABLE_SCENES = 3
_NODE_ID = "ray.io/node-id"


class ExcludedMachines:
    """Set of the machines that are left out. cpus: CPUs of a worker.

    Attributes:
        lines: one per machine, in the order in which they were left out.
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
        """Leave a machine out. Return the line that says so."""
        line = f"{host} is left out: {error}"
        if node_id not in self._ids:
            self._ids.add(node_id)
            self.lines.append(line)
        return line

    def failed_start(self, node_id: str) -> bool:
        """Count a failed start on a machine. Return True if the limit is reached."""
        self._failed[node_id] += 1
        return self._failed[node_id] >= MAX_FAILED_STARTS

    def started(self, node_id: str) -> None:
        """Reset the count of failed starts on a machine, after a successful start."""
        del self._failed[node_id]

    def unread(self, node_id: str, scenes: set[str], done: bool) -> bool:
        """Count the scenes whose files a machine's tasks could not read or write. Return True if the limit is reached.

        done: the machine finished other tasks meanwhile, which resets the earlier count.
        """
        self._unread[node_id] = scenes | (set() if done else self._unread.get(node_id, set()))
        return len(self._unread[node_id]) >= MAX_UNREADABLE_SCENES

    def show(self) -> None:
        """Print the new lines. Called once other machines run tasks; if none does, the sweep's error reports them."""
        for line in self.lines[self._shown :]:
            write_line(line)
        self._shown = len(self.lines)

    def others(self) -> list[dict[str, Any]]:
        """Return the live machines that are not left out, as Ray describes them."""
        return [node for node in self._ray.nodes() if node["Alive"] and node.get("NodeID") not in self._ids]

    def any_other(self, than: str = "") -> bool:
        """True if a machine that is not left out has the CPUs for a worker. than: machine to ignore."""
        others = (node["Resources"] for node in self.others() if node.get("NodeID") != than)
        return any(resources.get("CPU", 0) >= self._cpus for resources in others)

    def options(self) -> Mapping[str, Any]:
        """Return the options of an actor that keep it off the machines left out."""
        return {"label_selector": {_NODE_ID: f"!in({','.join(sorted(self._ids))})"}} if self._ids else {}
