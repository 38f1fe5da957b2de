"""A small handmade suite: real files, eight scenes of random points, and a real user detector for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa

from shift3d.suite.frozen import background_file, blake2b, manifest_bytes
from shift3d.suite.tables import SUITE_SCHEMAS, SUITE_VERSION, suite_table, suite_table_bytes

SCENES, PER_SCENE, POINTS = 8, 3, 300
DETECTOR = '''
import torch

BOXES = torch.cartesian_prod(torch.arange(-30.0, 31.0, 10.0), torch.arange(-30.0, 31.0, 10.0))
BOXES = torch.cat((BOXES, torch.tensor([0.8, 4.5, 1.9, 1.6, 0.0]).expand(len(BOXES), 5)), dim=1)


def load(weights):
    """The more points stand at an anchor, the surer; weights: a text file with the bias of the logit."""
    bias = float(open(weights).read()) if weights else -2.0

    def model(points):
        above = torch.sigmoid(20.0 * (points[:, 2] - 0.3))
        near = torch.exp(-(points[:, None, :2] - BOXES[:, :2]).square().sum(-1) / 8.0)
        return BOXES.to(points), bias + 0.1 * (near * above[:, None]).sum(0)

    return model
'''


def write_detector(folder: Path, bias: float | None = None) -> tuple[str, str | None]:
    """Write the detector's Python file, and a file of weights with a bias; None: the detector's own bias."""
    (folder / "detector.py").write_text(DETECTOR)
    if bias is None:
        return str(folder / "detector.py"), None
    (folder / f"bias{bias:g}.txt").write_text(str(bias))
    return str(folder / "detector.py"), str(folder / f"bias{bias:g}.txt")


def write_suite(folder: Path, scenes: int = SCENES, scored_by: str = "") -> None:
    """Freeze hard objects of few points and controls of many. scored_by: detector that scored each of them 0.5."""
    rng = np.random.default_rng(5)
    files: dict[str, bytes] = {}
    objects = []
    for scene in range(scenes):
        points = rng.uniform((-40, -40, 0), (40, 40, 0.2), (POINTS, 3)).astype(np.float32)
        background = blake2b(points.tobytes())
        columns = [pa.array(points[:, axis]) for axis in range(3)]
        table = pa.Table.from_arrays(columns, schema=SUITE_SCHEMAS["background"])
        files[background_file(background)] = suite_table_bytes(table)
        for number in range(2 * PER_SCENE):
            role = ("control", "hard")[number % 2]
            centre = np.array([10.0 * (number // 2 + 1), 10.0, 0.8])
            count = int(rng.integers(8, 25)) + (15 if role == "control" else 0)
            new = (centre + rng.uniform(-0.9, 0.9, (count, 3)) * (2.2, 0.9, 0.5)).astype(np.float32)
            control = objects[-1]["object_id"] if role == "hard" else None
            objects.append(
                {
                    "object_id": blake2b(background.encode() + new.tobytes()),
                    "role": role,
                    "control": control,
                    "task_id": f"{scene:016x}{number // 2:016x}",
                    "method": "adversarial" if role == "hard" else "baseline",
                    **{"vehicle": "suv", "scene": f"scene-{scene}", "dataset": "by-hand", "mode": "shape"},
                    **{"replicate": 0, "background": background, "scene_hash": "", "frames": 0, "effects": []},
                    **dict(zip(("x_m", "y_m", "z_m"), centre.tolist(), strict=True)),
                    **{"ground_z_m": 0.0, "dx_m": 4.5, "dy_m": 1.9, "dz_m": 1.6, "heading_rad": 0.0},
                    **{"pitch_rad": 0.0, "roll_rad": 0.0, "radius_m": 5.0, "precision": "float32"},
                    **{"object_points": count, "latent_code": np.zeros(2, np.float32)},
                    # The last point belongs to a beam that had no return.
                    "rows": np.arange(count - 1, dtype=np.int32),
                    "points": new.ravel(),
                    "hits": np.append(np.arange(count - 1), POINTS).astype(np.int32),
                }
            )
    known = [{"object_id": row["object_id"], "detector": scored_by, "weights": "w", "score": 0.5} for row in objects]
    files["objects.parquet"] = suite_table_bytes(suite_table("objects", objects))
    files["scores.parquet"] = suite_table_bytes(suite_table("scores", known if scored_by else []))
    manifest = {
        **{"version": SUITE_VERSION, "frames": "copied", "scene_sets": [], "datasets": ["by-hand"]},
        **{"attacked": ["own"], "made": {"sweep": "by-hand", "spec_hash": "0"}, "scenes": scenes},
        **{"hard_objects": len(objects) // 2, "control_objects": len(objects) // 2},
        "files": {name: blake2b(content) for name, content in files.items()},
    }
    for name, content in {**files, "suite.json": manifest_bytes(manifest)}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
