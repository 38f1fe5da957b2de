"""A picture of a scene is a PNG with visible content."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.image import imread

from shift3d.scenes.picture import save_picture
from shift3d.scenes.street.assemble import street_scene


def test_a_picture_shows_points_and_boxes(tmp_path: Path) -> None:
    scene = street_scene("test", 0, 1, "hdl64")
    save_picture(scene, str(tmp_path / "scene.png"))
    image = imread(tmp_path / "scene.png")[..., :3]
    assert (image.min(axis=-1) < 0.9).mean() > 0.01
    red = (image[..., 0] > 0.7) & (image[..., 1] < 0.3) & (image[..., 2] < 0.3)
    assert np.count_nonzero(red) > 100
