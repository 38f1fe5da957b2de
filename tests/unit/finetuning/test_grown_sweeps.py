"""A held-out sweep with added objects is scored again by tuned weights; one without is not."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shift3d.errors import InputError
from shift3d.finetuning import report
from shift3d.finetuning.rescoring import RESCORED


def test_objects_of_tasks_that_were_retried_are_scored_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tuned = report.TunedModel("finetuned", 0, tmp_path / "finetuned-0", "pointpillars")
    tuned.folder.mkdir()
    tuned.weights.write_bytes(b"weights")
    tasks, scored, settings = ["t0"], [], ["shape"]

    def table(folder: Path, *_: object) -> pa.Table:
        row = {"vehicle": "suv", "place": "street/s", "settings": settings[-1], "score": 0.5}
        keys = [{"task_id": task, "method": method} for task in tasks for method in ("baseline", "adversarial")]
        return pa.Table.from_pylist([row | key for key in keys], schema=RESCORED)

    def rescored(folder: Path, *_: object) -> pa.Table:
        scored.append(folder.name)
        return table(folder)

    monkeypatch.setattr(report, "attacked_scores", table)
    monkeypatch.setattr(report, "rescore_objects", rescored)
    for grown in (True, False):
        report.score_held_out(tmp_path, tuned)
        assert scored == (list(report.HELD_OUT) if grown else [])
        scored.clear()
    settings.append("street/s shape")  # like another version's names: pairs would not be found
    report.score_held_out(tmp_path, tuned)
    assert scored == list(report.HELD_OUT)
    scored.clear()
    tasks.append("t1")
    report.score_held_out(tmp_path, tuned)
    assert scored == list(report.HELD_OUT)
    file = tuned.scores_file("held_out")
    assert pq.read_table(file)["task_id"].to_pylist() == ["t0", "t0", "t1", "t1"]
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(InputError, match=r"scores-held_out.*Remove the file"):
        report.score_held_out(tmp_path, tuned)
