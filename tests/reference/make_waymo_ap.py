"""Makes waymo_ap.json: random crowded frames, and the results of Waymo's own metrics library for them.

Run in an environment of its own, with Python 3.11: ``pip install tensorflow-cpu==2.13.0``, then the wheel of
waymo-open-dataset-tf-2-12-0 1.6.7, unpacked (only its compiled metrics are used), whose folder is the argument:

    python make_waymo_ap.py FOLDER > waymo_ap.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

FRAMES, CARS, DETECTIONS = 8, 9, 15


def make_frames() -> list[dict[str, list]]:
    """Make frames of cars so near each other, some overlapping, that detections compete; scores never at a cut-off."""
    rng = np.random.default_rng(20)
    frames = []
    for _ in range(FRAMES):
        x = np.cumsum(rng.uniform(0.5, 12.0, CARS)) - 10.0
        truth = np.zeros((CARS, 7))
        truth[:, 0], truth[:, 1] = x, rng.uniform(-0.3, 0.3, CARS) + rng.uniform(-30, 30)
        truth[:, 3:6] = np.array([4.0, 2.0, 1.6]) * rng.uniform(0.9, 1.1, (CARS, 3))
        truth[:, 6] = rng.normal(0, 0.1, CARS) + np.pi * rng.integers(0, 2, CARS)
        spread = np.array([0.3, 0.1, 0.1, 0.15, 0.1, 0.1, 0.1])
        found = truth[rng.integers(0, CARS, DETECTIONS)] + rng.normal(0, 1, (DETECTIONS, 7)) * spread
        found[:, 6] += np.pi * (rng.random(DETECTIONS) < 0.3)
        found[-2:, 1] += 20.0  # two false detections
        frames.append(
            {
                "truth": np.round(truth, 3).tolist(),
                "level": rng.integers(1, 3, CARS).tolist(),
                "found": np.round(found, 3).tolist(),
                "scores": ((rng.integers(0, 100, DETECTIONS) + 0.5) / 100).round(3).tolist(),
                "labelled": (rng.random(DETECTIONS) < 0.9).tolist(),
            }
        )
    return frames


def evaluate(folder: Path, frames: list[dict[str, list]], view: str, iou_threshold: float) -> list[dict]:
    """Return the library's AP, APH and curves of vehicles: all and by range, both levels."""
    sys.path.insert(0, str(folder))
    import tensorflow as tf
    from google.protobuf import text_format
    from waymo_open_dataset.protos import metrics_pb2

    operations = tf.load_op_library(str(folder / "waymo_open_dataset" / "metrics" / "ops" / "metrics_ops.so"))
    both = "difficulties { levels: LEVEL_1 levels: LEVEL_2 }"
    text = f"breakdown_generator_ids: OBJECT_TYPE {both} breakdown_generator_ids: RANGE {both}"
    text += f" matcher_type: TYPE_HUNGARIAN box_type: {'TYPE_2D' if view == 'BEV' else 'TYPE_3D'}"
    text += f" iou_thresholds: 0 iou_thresholds: {iou_threshold}" + " iou_thresholds: 0.5" * 3
    text += "".join(f" score_cutoffs: {index * 0.01}" for index in range(100)) + " score_cutoffs: 1.0"
    columns = [0, 1, 3, 4, 6] if view == "BEV" else list(range(7))
    found = np.concatenate([frame["found"] for frame in frames])[:, columns].astype(np.float32)
    truth = np.concatenate([frame["truth"] for frame in frames])[:, columns].astype(np.float32)
    output = operations.detection_metrics(
        prediction_bbox=found,
        prediction_type=np.ones(len(found), np.uint8),
        prediction_score=np.concatenate([frame["scores"] for frame in frames]).astype(np.float32),
        prediction_frame_id=np.repeat(np.arange(len(frames)), DETECTIONS),
        prediction_overlap_nlz=~np.concatenate([frame["labelled"] for frame in frames]),
        ground_truth_bbox=truth,
        ground_truth_type=np.ones(len(truth), np.uint8),
        ground_truth_frame_id=np.repeat(np.arange(len(frames)), CARS),
        ground_truth_difficulty=np.concatenate([frame["level"] for frame in frames]).astype(np.uint8),
        ground_truth_speed=np.zeros((len(truth), 2), np.float32),
        config=text_format.Parse(text, metrics_pb2.Config()).SerializeToString(),
    )
    ap, aph = output.average_precision.numpy(), output.average_precision_ha_weighted.numpy()
    curve, heading_curve = output.precision_recall.numpy(), output.precision_recall_ha_weighted.numpy()
    regions = {(2, 0): [0, None], (3, 0): [0, 30], (3, 1): [30, 50], (3, 2): [50, None]}
    results = []
    for row, (generator, shard, level) in enumerate(output.breakdown.numpy().tolist()):
        if (generator, shard) not in regions:
            continue  # another type of object
        answer = {"view": view, "iou_threshold": iou_threshold, "range_m": regions[generator, shard], "level": level}
        answer |= {"ap": round(float(ap[row]), 7), "aph": round(float(aph[row]), 7)}
        if generator == 2:  # the whole curve once, the areas of the range bins
            answer["precision"] = curve[row, :, 0].astype(float).round(6).tolist()
            answer["recall"] = curve[row, :, 1].astype(float).round(6).tolist()
            answer["heading_precision"] = heading_curve[row, :, 0].astype(float).round(6).tolist()
        results.append(answer)
    return results


def main() -> None:
    """Print the frames and the library's results as JSON."""
    frames = make_frames()
    answers = [
        answer
        for view in ("BEV", "3D")
        for iou_threshold in (0.7, 0.5)
        for answer in evaluate(Path(sys.argv[1]), frames, view, iou_threshold)
    ]
    print(json.dumps({"library": "waymo-open-dataset-tf-2-12-0 1.6.7", "frames": frames, "answers": answers}))


if __name__ == "__main__":
    main()
