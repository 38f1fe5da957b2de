"""The overlap of oriented boxes against shapely's polygon clipping."""

import numpy as np
import pytest
import shapely

from shift3d.geometry.boxes import corners_bev
from shift3d.geometry.iou import iou_bev


def _clipped(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = (shapely.polygons(corners_bev(boxes)) for boxes in (a, b))
    overlap = shapely.area(shapely.intersection(first[:, None], second[None, :]))
    return overlap / (shapely.area(first)[:, None] + shapely.area(second)[None, :] - overlap)


def _boxes(count: int, seed: int, spread_m: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    boxes = np.zeros((count, 7))
    boxes[:, :2] = rng.uniform(-spread_m, spread_m, (count, 2))
    boxes[:, 3:6] = rng.uniform(0.3, 6.0, (count, 3))
    boxes[:, 6] = rng.uniform(-10.0, 10.0, count)
    return boxes


@pytest.mark.parametrize("spread_m", [0.5, 4.0])
def test_boxes_in_every_position(spread_m: float) -> None:
    a, b = _boxes(300, 0, spread_m), _boxes(60, 1, spread_m)
    expected = _clipped(a, b)
    np.testing.assert_allclose(iou_bev(a, b), expected, atol=1e-12)
    assert np.array_equal(iou_bev(a, b) > 0, expected > 0)


def test_shared_edges_right_angles_and_nesting() -> None:
    """Clipping must decide ties: coincident edges, corners on edges, one box inside the other."""
    headings = np.repeat(np.arange(8) * np.pi / 4, 9)
    boxes = np.zeros((len(headings), 7))
    boxes[:, 0] = np.tile([0.0, 1.0, 2.0], 24)
    boxes[:, 1] = np.tile(np.repeat([0.0, 0.5, 1.0], 3), 8)
    boxes[:, 3:6] = (2.0, 1.0, 1.0)
    boxes[:, 6] = headings
    boxes[::5, 3:5] *= 0.5
    np.testing.assert_allclose(iou_bev(boxes, boxes), _clipped(boxes, boxes), atol=1e-12)
    np.testing.assert_allclose(np.diag(iou_bev(boxes, boxes)), 1.0, atol=1e-12)


def test_thin_boxes_and_great_distances_lose_no_digits() -> None:
    thin = _boxes(40, 2, 2.0)
    thin[:, 4] = 1e-6
    broad = _boxes(40, 3, 2.0)
    np.testing.assert_allclose(iou_bev(thin, broad), _clipped(thin, broad), rtol=1e-6, atol=1e-14)
