"""Mutants of KITTI frames: points, labels, calibration, and real frames if they exist."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from feeding import InputKind, register
from mutations import Rng, mutate_bytes, mutate_text, pick
from valid_frames import NAME, write_frame
from value_mutations import write_specials

from shift3d.scenes.kitti.files import CLASSES
from shift3d.scenes.kitti.scenes import KittiScenes

FARTHEST_M = 1e4
ROOT = Path(__file__).resolve().parents[2]
REAL = Path(os.environ.get("SHIFT3D_REAL_DATA", ROOT.parent / "shared" / "real")) / "kitti" / "training"


def load_frame(folder: Path) -> Any:
    """Read everything of a frame. Returns a digest."""
    scenes = KittiScenes(folder)
    assert scenes.names() == [NAME]
    scene = scenes.load(NAME)
    points, boxes = scene.points, scene.labels.boxes
    assert points.dtype == np.float32 and points.shape == (len(points), 3) and np.isfinite(points).all()
    assert np.abs(points).max() <= FARTHEST_M
    assert scene.reflectance is not None and scene.reflectance.dtype == np.float32
    assert scene.reflectance.shape == (len(points),) and ((scene.reflectance >= 0) & (scene.reflectance <= 1)).all()
    assert np.isfinite(boxes).all() and boxes.dtype == np.float64 and (boxes[:, 3:6] > 0).all()
    assert np.abs(boxes).max(initial=0.0) <= FARTHEST_M
    assert -2.1 < scene.ground_z_m < -1.3
    assert (scene.labels.num_points >= 0).all() and (scene.labels.num_points <= len(points)).all()
    assert set(scene.labels.names) <= CLASSES.keys()
    view, rows = scenes.camera_view(NAME), scenes.label_rows(NAME)
    assert len(rows) == len(boxes) and all(0 <= row.difficulty <= 3 for row in rows)
    assert all(np.isfinite([row.truncation, row.image_height_px]).all() for row in rows)
    seen, height = view.in_view(boxes), view.height_px(boxes)
    assert seen.dtype == np.bool_ and np.isfinite(height).all() and (height >= 0).all()
    pixels, depth = view.pixels(points)
    assert np.isfinite(pixels).all() and np.isfinite(depth).all()
    rotation = view.camera_T_lidar[:3, :3]
    assert np.allclose(rotation @ rotation.T, np.eye(3), atol=0.02)
    digest = hashlib.sha256(scene.content_hash().encode())
    for array in (view.camera_T_lidar, view.image_P_camera, seen, height):
        digest.update(np.ascontiguousarray(array).tobytes())
    digest.update(repr([(row.truncation, row.occlusion, row.image_height_px) for row in rows]).encode())
    return digest.hexdigest()


def mutate_points(folder: Path, rng: Rng) -> str:
    path = folder / "training" / "velodyne" / f"{NAME}.bin"
    if rng.uniform() < 0.5:
        path.write_bytes(mutate_bytes(path.read_bytes(), rng))
        return "bytes"
    points = np.fromfile(path, "<f4").reshape(-1, 4)
    how = pick(("special", "float64", "float16", "three columns", "five columns", "copies", "no beam", "empty"), rng)
    if how == "special":
        points = write_specials(points, rng)
    elif how == "copies":
        points = points[rng.integers(len(points), size=len(points))]
    elif how == "no beam":
        points = points * (0.0, 0.0, 0.0, 1.0)
    elif how in ("float64", "float16"):
        points.astype(how).tofile(path)
        return str(how)
    else:
        points = {"three columns": points[:, :3], "five columns": points[:, [0, 1, 2, 3, 3]], "empty": points[:0]}[how]
    points.astype("<f4").tofile(path)
    return str(how)


def _without_meaning(text: str, rng: Rng) -> str:
    """Change blanks, line ends and empty lines: the same words in the same lines."""
    how = pick(("blanks", "crlf", "empty", "end", "tabs"), rng)
    if how == "crlf":
        return text.replace("\n", "\r\n")
    if how == "tabs":
        return text.replace(" ", "\t")
    if how == "end":
        return text.rstrip("\n")
    return text.replace(" ", "  ") if how == "blanks" else text.replace("\n", "\n\n")


def text_mutator(part: str) -> Callable[[Path, Rng], str]:
    def mutate(folder: Path, rng: Rng) -> str:
        path = folder / "training" / part / f"{NAME}.txt"
        if rng.uniform() < 0.06:
            path.write_bytes(_without_meaning(path.read_text(), rng).encode())
            return "harmless"
        path.write_bytes(mutate_text(path.read_bytes(), rng))
        return "text"

    return mutate


def write_real_frame(folder: Path) -> None:
    """Write a real frame with every tenth point, so that mutants stay cheap."""
    for part, suffix in (("velodyne", "bin"), ("calib", "txt"), ("label_2", "txt")):
        (folder / "training" / part).mkdir(parents=True)
        source = sorted((REAL / part).glob(f"*.{suffix}"))[0]
        content = source.read_bytes()
        if suffix == "bin":
            content = np.frombuffer(content, "<f4").reshape(-1, 4)[::10].tobytes()
        (folder / "training" / part / f"{NAME}.{suffix}").write_bytes(content)


def mutate_real_frame(folder: Path, rng: Rng) -> str:
    part = pick(("velodyne", "calib", "label_2"), rng)
    return {"velodyne": mutate_points, "calib": text_mutator("calib"), "label_2": text_mutator("label_2")}[part](
        folder, rng
    )


register(InputKind("KITTI points", 400, write_frame, mutate_points, load_frame))
register(InputKind("KITTI labels", 300, write_frame, text_mutator("label_2"), load_frame))
register(InputKind("KITTI calibration", 300, write_frame, text_mutator("calib"), load_frame))
if REAL.is_dir():
    register(InputKind("KITTI real frame", 100, write_real_frame, mutate_real_frame, load_frame))
