"""A sweep's first result comes early: the cheapest task of a vehicle first, and no clock before its commit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from by_hand import catalogue

from shift3d.settings.compose import compose_sweep
from shift3d.store.log import CommitLog
from shift3d.store.resolve import as_location
from shift3d.sweep.drive import execution_order
from shift3d.sweep.execution.worker import BatchOutcome
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.planning.tasks import Tasks
from shift3d.sweep.results.commit import Committer


def tasks(*words: str) -> Tasks:
    return make_plan(compose_sweep("default", words), catalogue)[0].tasks


@pytest.mark.parametrize("transfers", [0, 1])
def test_pose_attacks_go_first_and_tasks_of_a_vehicle_in_a_scene_stay_together(transfers: int) -> None:
    words = ("vehicle=suv,coupe", "mode=shape,pose", "attack.lambda=1,10", f"attack.transfer_scenes={transfers}")
    planned = tasks(*words)
    order = [planned[position].spec for position in execution_order(planned, np.arange(len(planned)))]
    found = [(spec.vehicle, spec.scene, spec.mode, spec.lambda_) for spec in order]
    searches = [("pose", None), ("shape", 1.0), ("shape", 10.0)]
    in_turn = [(scene, *search) for scene in ("north", "south") for search in searches]
    assert found == [(vehicle, *entry) for vehicle in ("suv", "coupe") for entry in in_turn]


@pytest.mark.parametrize("words", [("mode=shape",), ("mode=pose",), ("mode=pose,shape",)])
def test_every_task_once_and_in_plan_order_where_that_is_cheapest_already(words: tuple[str, ...]) -> None:
    planned = tasks("vehicle=suv,coupe", *words, "attack.lambda=1")
    left = np.array([0, 1, 3])
    assert execution_order(planned, left).tolist() == left.tolist()
    assert execution_order(planned, left[:0]).tolist() == []


def test_a_result_after_a_quiet_time_waits_for_no_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    log = CommitLog(as_location(tmp_path), "spec")
    committer = Committer(log, every_s=2.0)
    for now, done, committed in [(1.9, [], 0), (2.5, [], 0), (3.9, ["a"], 1), (5.0, ["b"], 1), (6.0, ["c"], 3)]:
        clock[0] = now
        committer.add(BatchOutcome(done=done))
        assert len(log.done()) == committed, now
