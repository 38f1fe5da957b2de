"""A task against a detector of another codebase: from what a worker is sent to rows."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from foreign_cases import CASES, far
from short_tasks import STREET, make_spec

from shift3d.detectors.foreign.detector import foreign_layout
from shift3d.errors import InputError
from shift3d.settings.catalogue import detector_hash
from shift3d.task.asset_files import NamedFiles, named_files
from shift3d.task.assets import load_assets
from shift3d.task.run import run_task
from shift3d.task.spec import AssetsSpec


def sent(folder: Path) -> AssetsSpec:
    config, weights = far(CASES["mmdet3d-centerpoint"], folder)
    layout = foreign_layout("mmdet3d", config)
    config.unlink()  # a worker has none
    return AssetsSpec(
        scenes=STREET,
        detectors={"mmdet3d": str(weights)},
        hashes={"mmdet3d": detector_hash("mmdet3d", str(weights), None, layout)},
        layouts={"mmdet3d": json.loads(json.dumps(layout))},
    )


def test_a_task_runs_on_what_a_worker_is_sent(tmp_path: Path) -> None:
    spec = sent(tmp_path)
    assert named_files(spec) == (NamedFiles(str(tmp_path), ("model.pth",)),)
    task = make_spec(detector="mmdet3d", scored_by=("mmdet3d",))
    result = run_task(task, load_assets(spec))
    assert {row["scored_by"] for row in result.scores} == {"mmdet3d"}
    assert {"baseline", "adversarial"} <= {row["method"] for row in result.scores}
    assert all(row["status"] == "ok" and 0.0 <= row["score"] <= 1.0 for row in result.scores)


def test_another_layout_than_planned_is_refused(tmp_path: Path) -> None:
    spec = sent(tmp_path)
    layout = dict(spec.layouts["mmdet3d"]) | {"suppression_iou": 0.5}
    with pytest.raises(InputError, match="changed after the sweep was planned"):
        load_assets(dataclasses.replace(spec, layouts={"mmdet3d": layout}))
