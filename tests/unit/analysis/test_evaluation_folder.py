"""An evaluation's folder: the same bytes for the same detections, and all data to repeat the computation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from shift3d.analysis.detector_evaluation import write_evaluation
from shift3d.analysis.tables.detector_tables import metric_table
from shift3d.errors import InputError
from shift3d.evaluation.frames import DetectedFrame, FrameDetections, GroundTruth
from shift3d.evaluation.metrics import evaluate
from shift3d.store.evaluation_tables import evaluation_table
from shift3d.training.detector.detect_scenes import SceneDetections

BOX = ["x_m", "y_m", "z_m", "dx_m", "dy_m", "dz_m", "heading_rad"]


def _answers(graded: bool = False, milliseconds: float = 1.0) -> list[SceneDetections]:
    answers = []
    rng = np.random.default_rng(3)
    for index in range(4):
        count = 0 if index == 2 else 6  # one frame without a vehicle
        boxes = np.zeros((count, 7))
        boxes[:, 0] = np.cumsum(rng.uniform(5, 15, count))
        boxes[:, 2:6] = (0.8, 4.0, 2.0, 1.6)
        boxes[:, 6] = rng.uniform(-0.3, 0.3, count)
        truth = GroundTruth(
            boxes,
            rng.integers(0, 60, count),
            rng.random(count) < 0.8,
            rng.integers(0, 4, count) if graded else np.full(count, -1, dtype=np.int64),
            ("Car",) * count,
        )
        wrong = boxes[: count // 2] + np.array([0, 30, 0, 0, 0, 0, 0])
        moved = np.concatenate((boxes + rng.normal(0, 0.1, boxes.shape), wrong))
        pixels = rng.uniform(20, 90, len(moved)) if graded else np.full(len(moved), np.nan)
        found = FrameDetections(moved, rng.uniform(0.02, 0.98, len(moved)), rng.random(len(moved)) < 0.9, pixels)
        answers.append(SceneDetections(DetectedFrame(f"frame-{index}", truth, found), milliseconds, 2 * milliseconds))
    return answers


def _bytes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of detections without grades, and what is printed of it; tests only read it."""
    folder = tmp_path_factory.mktemp("evaluation") / "plain"
    return folder, write_evaluation("toy", "small", _answers(), folder)


def test_the_same_detections_give_the_same_bytes_but_for_the_times(plain: tuple[Path, str], tmp_path: Path) -> None:
    write_evaluation("toy", "small", _answers(milliseconds=7.0), tmp_path)
    a, b = _bytes(plain[0]), _bytes(tmp_path)
    names = ("metrics", "curves", "detections", "truth", "vehicles", "breakdown", "timings")
    assert set(a) == {f"{name}.parquet" for name in names} | {"curves.png"}
    assert {name for name in a if a[name] != b[name]} == {"timings.parquet"}


@pytest.mark.parametrize("graded", [False, True])
def test_detections_and_truth_suffice_to_compute_every_metric_again(
    plain: tuple[Path, str], tmp_path: Path, graded: bool
) -> None:
    answers, (folder, _) = _answers(graded), plain
    if graded:
        write_evaluation("toy", "small", answers, folder := tmp_path)
    detections, truth = (pd.read_parquet(folder / f"{name}.parquet") for name in ("detections", "truth"))
    frames = []
    for scene in [answer.frame.scene for answer in answers]:
        d, t = detections[detections["scene"] == scene], truth[truth["scene"] == scene]
        frames.append(
            DetectedFrame(
                scene,
                GroundTruth(
                    t[BOX].to_numpy(),
                    t["num_points"].to_numpy(),
                    t["counts"].to_numpy(dtype=bool),
                    t["difficulty"].fillna(-1).to_numpy(dtype=np.int64),
                    tuple(t["name"]),
                ),
                FrameDetections(
                    d[BOX].to_numpy(),
                    d["score"].to_numpy(),
                    d["labelled"].to_numpy(dtype=bool),
                    d["image_height_px"].to_numpy(dtype=float, na_value=np.nan),
                ),
            )
        )
    metrics = pd.read_parquet(folder / "metrics.parquet")
    again = [
        value
        for metric in evaluate(frames)
        for value in (metric.curve.average_precision, metric.curve.average_precision_heading)
    ]
    np.testing.assert_array_equal(metrics["value"].to_numpy(dtype=float, na_value=np.nan), np.array(again, dtype=float))
    assert (metrics["metric"].tolist()[:2], set(metrics["num_scenes"])) == (["AP", "APH"], {4})


def test_tables_carry_their_schema_and_null_where_nothing_was_to_be_found(tmp_path: Path) -> None:
    empty = [SceneDetections(DetectedFrame("f", _answers()[2].frame.truth, _answers()[0].frame.found), 1.0, 1.0)]
    printed = write_evaluation("toy", "small", empty, tmp_path)
    table = pq.read_table(tmp_path / "metrics.parquet")
    assert table.schema.metadata[b"shift3d.schema"] == b"evaluation_metrics"
    assert table.schema.metadata[b"shift3d.schema_version"] == b"2"
    assert table["value"].null_count == table.num_rows > 0 and set(table["num_truth"].to_pylist()) == {0}
    assert "nan" not in printed.lower() and json.dumps(printed)


def test_the_printed_table_names_what_each_line_is(tmp_path: Path) -> None:
    metrics = list(evaluate([answer.frame for answer in _answers(graded=True)]))
    lines = str(metric_table("toy on small", metrics)).splitlines()
    assert lines[0] == "toy on small"
    assert " ".join(lines[1].split()) == "IoU objects range m BEV AP BEV APH 3D AP 3D APH number"
    first = next(m for m in metrics if (m.protocol, m.view) == ("waymo", "BEV"))
    assert lines[3].split()[:5] == ["Waymo", "0.7", "LEVEL_1", "0-75", f"{first.curve.average_precision:.3f}"]
    assert lines[3].split()[-1] == str(first.curve.num_truth)
    assert len([line for line in lines if line.startswith("KITTI")]) == 6
    assert len({line[: lines[1].index("BEV AP")] for line in lines[3:]}) == len(lines[3:])


def test_the_short_table_comes_first_with_intervals_and_agrees_with_the_folder(plain: tuple[Path, str]) -> None:
    folder, printed = plain
    table = pd.read_parquet(folder / "breakdown.parquet")
    whole = table[(table["by"] == "all") & (table["measure"] == "AP") & (table["statistic"] == "3D")].iloc[0]
    line = next(line for line in printed.splitlines()[:8] if line.startswith("3D AP"))
    assert line.split()[2:6] == [f"{whole['value']:.3f}", f"{whole['low']:.3f}", "to", f"{whole['high']:.3f}"]
    vehicles = pd.read_parquet(folder / "vehicles.parquet")
    near = vehicles[(vehicles["range_m"] < 75) & (vehicles["num_points"] >= 6)]
    matched = near[near["score"] >= 0.3]
    errors = table[(table["by"] == "all") & (table["measure"] == "error_z_m")].set_index("statistic")["value"]
    assert errors["mean"] == pytest.approx(matched["error_z_m"].mean())
    assert errors["std"] == pytest.approx(matched["error_z_m"].std(ddof=0))
    recall = table[(table["by"] == "all") & (table["measure"] == "recall") & (table["statistic"] == "BEV 0.5")]
    assert recall["value"].item() == pytest.approx(len(matched) / len(near))


def test_a_table_refuses_what_is_missing_or_not_finite() -> None:
    columns = {"detector": ["a"], "dataset": ["b"], "scene": ["c"], "scene_ms": [1.0], "detect_ms": [np.nan]}
    with pytest.raises(InputError, match="detect_ms"):
        evaluation_table("timings", columns)
    with pytest.raises(ValueError, match="scene_ms"):
        evaluation_table("timings", {key: value for key, value in columns.items() if key != "scene_ms"})
