"""Signed-distance samples against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from shift3d.errors import InputError
from shift3d.sdf.samples import SPHERE_MARGIN, bounding_scale, sample_sdf, signed_distance
from shift3d.seeding import generator


def box_distance(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the exact signed distance to an axis-aligned box about the origin."""
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def test_distance_to_a_box_is_exact_in_sign_and_size() -> None:
    points = generator("box points").uniform(-2, 2, (2000, 3))
    box = trimesh.creation.box((2.0, 1.0, 0.6))
    assert signed_distance(box, points) == pytest.approx(box_distance(points, np.array([1.0, 0.5, 0.3])), abs=1e-12)


def test_distance_to_a_sphere_is_radius_minus_one() -> None:
    points = generator("ball points").normal(0, 0.8, (500, 3))
    ball = trimesh.creation.icosphere(subdivisions=5)
    assert signed_distance(ball, points) == pytest.approx(np.linalg.norm(points, axis=1) - 1, abs=1e-3)


def test_samples_are_normalised_into_the_unit_sphere_and_true_to_the_mesh() -> None:
    half = np.array([2.0, 1.0, 0.5])
    box = trimesh.creation.box(2 * half)
    box.apply_translation([10.0, -3.0, 1.0])
    samples = sample_sdf(box, 4000, generator("samples"))
    assert samples.scale_m == pytest.approx(np.linalg.norm(half) * SPHERE_MARGIN)
    assert samples.scale_m == bounding_scale(box)
    expected = box_distance(samples.points.astype(np.float64), half / samples.scale_m)
    assert samples.distances == pytest.approx(expected, abs=1e-6)
    near = np.abs(samples.distances) < 0.1
    assert near.mean() > 0.8
    assert 0.2 < (samples.distances < 0).mean() < 0.7


def test_samples_are_the_same_for_the_same_generator() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    first, second = (sample_sdf(box, 300, generator("same")) for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.distances, second.distances)


def test_an_open_mesh_is_refused() -> None:
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    box.update_faces(np.arange(11))
    with pytest.raises(InputError, match="not closed"):
        sample_sdf(box, 100, generator("open"))
