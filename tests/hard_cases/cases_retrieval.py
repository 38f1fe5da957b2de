"""Hard cases of crops: a sensor inside a labelled box."""

from __future__ import annotations

import numpy as np
from catalogue import hard_case

from shift3d.retrieval.crops import crop_vehicles
from shift3d.retrieval.fit import turned
from shift3d.scenes.scene import Labels, Scene

AREA = "retrieval"


@hard_case(
    area=AREA,
    why="a label around the sensor: the way of a beam through that box begins behind the sensor",
    must="every place marked free lies on a beam, between the sensor and its return",
    guard="a way through a box begins at the sensor, where that is in it",
)
def a_sensor_inside_a_labelled_box() -> None:
    box = np.array([0.3, 0.1, 0.0, 4.5, 1.8, 1.5, 0.3])
    azimuth = np.linspace(-1.0, 1.0, 60)
    aims = np.stack((np.cos(azimuth), np.sin(azimuth), 0.1 * np.sin(7.0 * azimuth)), axis=1)  # nothing visible behind
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    points = (aims * np.tile((0.5, 1.5, 20.0), 20)[:, None]).astype(np.float32)
    labels = Labels(box[None], ("vehicle",), np.array([40], np.int32))
    crop = crop_vehicles(Scene("hard", "made", points, np.zeros_like(points), -1.7, labels=labels))[0]
    assert not crop.refused and len(crop.free)
    places = turned(crop.free, box[6]) + box[:3]
    along = np.clip(places @ aims.T, 0.0, np.linalg.norm(points, axis=1))
    apart = np.linalg.norm(places[:, None] - along[..., None] * aims, axis=2)
    assert apart.min(axis=1).max() < 1e-6
