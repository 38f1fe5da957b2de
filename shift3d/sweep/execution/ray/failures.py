"""Classification of Ray errors: kind of failure, and whether it is charged to the task."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

Kind = Literal["crashed", "out_of_memory", "timeout", "node_lost", "unreachable", "not_loaded"]

_NODE_TEXTS = ("node has died", "node was terminated", "node it ran on", "node died")
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_NO_MEMORY = "the worker ran out of memory (raise runner.worker_memory_mb or lower runner.workers)"
_MEMORY_TEXTS = ("out of memory", "out-of-memory", "running low on memory", "OOM")


@dataclass(frozen=True)
class Failure:
    """Reason why a call gave no result.

    kind: outcome in ``attempts``. what: message for the user. traceback: of the worker, if known.
    """

    kind: Kind
    what: str
    traceback: str | None = None

    @property
    def charged(self) -> bool:
        """True if a task that ran alone may be the cause. A lost machine is never charged to a task."""
        return self.kind in ("crashed", "out_of_memory", "timeout")


def failure_of(ray: Any, error: Exception, node_id: str) -> Failure:
    """Return the failure that an error of a call means. node_id: of the worker's machine."""
    errors = ray.exceptions
    text = _plain(str(error))
    if names_lost_machine(ray, error):
        return Failure("node_lost", f"the machine went away: {text}")
    if isinstance(error, errors.OutOfMemoryError | MemoryError) or "MemoryError" in type(error).__name__:
        return Failure("out_of_memory", f"{_NO_MEMORY}: {text}")
    if not any(node["NodeID"] == node_id and node["Alive"] for node in ray.nodes()):
        return Failure("node_lost", f"the machine went away: {text}")
    if isinstance(error, errors.ActorUnavailableError):
        return Failure("unreachable", f"the worker does not answer: {text}")
    if any(t in text for t in _MEMORY_TEXTS):
        return Failure("out_of_memory", f"{_NO_MEMORY}: {text}")
    if isinstance(error, errors.RayTaskError):
        cause = error.cause
        raised = f"{type(cause).__name__}: {cause}"[:2_000]
        return Failure("crashed", f"the worker failed: {raised}", _COLOURS.sub("", str(error))[-20_000:])
    return Failure("crashed", f"the worker died: {text}")


def names_lost_machine(ray: Any, error: Exception) -> bool:
    """True if the error itself says that a machine was lost."""
    errors = ray.exceptions
    lost = (errors.NodeDiedError, errors.ObjectLostError, errors.LocalRayletDiedError)
    if isinstance(error, lost) or getattr(error, "preempted", False):
        return True
    text = _plain(str(error))
    return any(of_node in text for of_node in _NODE_TEXTS)


def _plain(text: str) -> str:
    """Return the message of Ray without the ids before it and the advice after it. The advice names the out-of-memory
    killer as a possible cause for every killed process, which proves nothing."""
    text = " ".join(text.split())
    start = max(text.find("The actor is dead because"), text.find("The actor died because"), 0)
    return text[start:].partition("Some common causes include")[0].strip()[:2_000]
