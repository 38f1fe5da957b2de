"""Pictures: content and place of the camera's view."""

from __future__ import annotations

import numpy as np
import trimesh

from shift3d.vehicles.picture import shaded, view_axes


def test_axes_are_a_right_handed_frame_looking_at_the_origin() -> None:
    axes = view_axes(0.4, 0.3)
    assert np.allclose(axes @ axes.T, np.eye(3))
    assert np.isclose(np.linalg.det(axes), 1.0)
    assert axes[1, 2] > 0


def test_a_box_fills_its_share_of_the_picture() -> None:
    picture = shaded(trimesh.creation.box((2.0, 1.0, 1.0)), np.pi / 2, 0.0, 80, 40, span_m=4.0)
    covered = (picture < 255).any(axis=2)
    assert picture.shape == (40, 80, 3)
    assert covered.sum() == 40 * 20
    assert covered[10:30, 20:60].all()
