"""What runs at this moment: for whoever watches a sweep."""

from __future__ import annotations

from dataclasses import dataclass

from shift3d.sweep.planning.tasks import PlannedTask


@dataclass(frozen=True)
class Running:
    """A call in flight. task: its first one. tasks: how many it holds. seconds: since it was given out.

    worker: host and process that it was given to.
    """

    task: PlannedTask
    tasks: int
    seconds: float
    worker: str

    @property
    def label(self) -> str:
        """vehicle/scene, the mode, and how many more there are."""
        spec = self.task.spec
        more = f" +{self.tasks - 1}" if self.tasks > 1 else ""
        return f"{spec.vehicle}/{spec.scene} {spec.mode}{more}"
