"""Overdue calls of workers that nobody can see: ended in time, and no task is charged without proof."""

from __future__ import annotations

import time
from typing import Any

import pytest

from shift3d.sweep.execution.ray.calls import Call
from shift3d.sweep.execution.ray.hang_detector import HangDetector
from shift3d.sweep.execution.ray.worker_pool import PooledWorker


class UnansweringRay:
    """Cluster that answers no question: the machine is overloaded, or gone without Ray's knowledge."""

    def wait(self, references: list[Any], timeout: float) -> tuple[list[Any], list[Any]]:
        return [], references


def questioned(seconds_ago: float, positions: list[int]) -> Call:
    now = time.monotonic()
    return Call(
        "call", PooledWorker(None), positions, 1, began=now - 60, question="question", questioned_at=now - seconds_ago
    )


def test_a_question_may_take_a_while() -> None:
    assert HangDetector(UnansweringRay(), timeout_s=1.0).hanging([questioned(10.0, [7])]) == []


@pytest.mark.parametrize(("positions", "culprit"), [([7], 7), ([7, 8], None)])
def test_a_worker_that_nobody_sees_has_hung_and_one_of_several_tasks_is_not_singled_out(
    positions: list[int], culprit: int | None
) -> None:
    (hang,) = HangDetector(UnansweringRay(), timeout_s=1.0).hanging([questioned(21.0, positions)])
    assert hang.position == culprit
    assert hang.failure.kind == "timeout" and "nobody could see where the worker is" in hang.failure.what


def test_without_a_time_limit_nothing_hangs() -> None:
    assert HangDetector(UnansweringRay(), timeout_s=None).hanging([questioned(1e6, [7])]) == []
