"""Object of a suite for pictures: points from above and from the side, with the detector's box."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from shift3d.analysis.cases.rendered import VIEW_M, best_box, thinned
from shift3d.suite.frozen import FrozenSuite, box_of
from shift3d.suite.scoring import Scorer
from shift3d.task.scoring import boxes_around

FloatArray = NDArray[np.float64]
_SIDE_M = 3.0


@dataclass(frozen=True)
class FrozenView:
    """Points and boxes of a suite's object, metres. scene_xy, object_xy: (P, 2), (Q, 2) points from above, scene frame.
    scene_side, object_side: (distance along the heading from the object's centre, height above ground); scene points
    within 3 m of the object's axis. box: (7,) ground truth, found: (7,) best box within the detection radius or None;
    network frame."""

    scene_xy: FloatArray
    object_xy: FloatArray
    scene_side: FloatArray
    object_side: FloatArray
    box: FloatArray
    found: FloatArray | None
    score: float


def view_of(suite: FrozenSuite, row: Mapping[str, Any], scorer: Scorer) -> FrozenView:
    """Detect and view an object, given its row of the suite. Raises: InputError as `FrozenSuite.background`."""
    points, box = suite.points_of(row, suite.background(row["background"])), box_of(row)
    detectors = {scorer.name: scorer.at(row["precision"])}
    proposals = boxes_around(torch.from_numpy(points), box, row["ground_z_m"], detectors)[scorer.name]
    found, score = best_box(proposals, box, row["radius_m"])
    hit = np.zeros(len(points), dtype=bool)
    hit[np.asarray(row["hits"], dtype=np.int64)] = True
    at = points.astype(np.float64)
    along, across = np.array([np.cos(box[6]), np.sin(box[6])]), np.array([-np.sin(box[6]), np.cos(box[6])])
    offset = at[:, :2] - box[:2]
    side = np.stack((offset @ along, at[:, 2] - row["ground_z_m"]), axis=1)
    beside = np.abs(offset @ across) < _SIDE_M
    return FrozenView(
        scene_xy=thinned(at[~hit, :2], box[:2]),
        object_xy=at[hit, :2],
        scene_side=thinned(side[~hit & beside & (np.abs(side[:, 0]) < VIEW_M)], np.zeros(2)),
        object_side=side[hit],
        box=box,
        found=found,
        score=score,
    )
