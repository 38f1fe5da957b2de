"""In which order tasks are given to workers. Results are sorted by plan order, and do not depend on it."""

from __future__ import annotations

import numpy as np

from shift3d.sweep.planning.tasks import Tasks

__all__ = ["cheapest_first"]


def cheapest_first(tasks: Tasks, positions: np.ndarray) -> np.ndarray:
    """Positions in a plan, pose attacks before shape attacks wherever neighbours share a vehicle.

    A pose attack takes about two thirds of a shape attack's time and makes no mesh, so a sweep's first result is there
    sooner. Tasks of a vehicle stay together: a worker prepares each vehicle once. Otherwise in plan order.

    Args:
        positions: ascending.

    Source: our choice.
    """
    templates = tasks.templates
    names = list(dict.fromkeys(template.vehicle for template in templates))
    vehicle = np.array([names.index(template.vehicle) for template in templates], dtype=np.int64)
    is_shape = np.array([template.mode == "shape" for template in templates], dtype=np.int64)
    template = tasks.template[positions]
    runs = np.cumsum(np.diff(vehicle[template], prepend=-1) != 0)
    return positions[np.argsort(2 * runs + is_shape[template], kind="stable")]
