"""The same vehicles under the beams of several sensors."""

from __future__ import annotations

from shift3d.analysis.html.blocks import Paragraph, Section
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.sensors import sensor_table

__all__ = ["sensors"]

_LEAD = (
    "The same street and the same place, seen by another sensor from the same point. A baseline is one object under "
    "every sensor: what it loses is lost to the beams. An adversarial object was searched under its own beams. A miss "
    "under every sensor is the detector's; one under some sensors alone is for want of what these see. Differences are "
    "object by object; intervals redraw whole streets."
)


def sensors(sweep: Sweep) -> Section | None:
    """The section; None where a sweep has the beams of one sensor alone."""
    table = sensor_table(sweep.scores)
    return None if table is None else Section("sensors", "Sensor or detector", [Paragraph(_LEAD), table])
