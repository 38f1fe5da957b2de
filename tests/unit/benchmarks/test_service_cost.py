"""The cost model by hand: the load that one driver can feed."""

from __future__ import annotations

import dataclasses

import pytest
from benchmarks.service_cost import Parts, forecast, forecast_lines

PARTS = Parts(overhead_us=200, commit_ms=40, call_us=300, transfer_mb_s=500, weights_mb=50, task_s=2)


def test_a_thousand_workers_by_hand() -> None:
    found = forecast(PARTS, workers=1000, tasks=10**7)
    assert found.hours == pytest.approx(1e7 * 2 / 1000 / 3600)
    assert found.busy == pytest.approx({"rows of tasks": 0.1, "commits": 0.02, "calls to workers": 0.1})
    assert found.weights_s == pytest.approx(100)
    # With tasks this short, rows, commits and calls take the driver's whole time.
    assert 1000 / found.shortest_task_s * 200e-6 + 0.02 + 0.1 == pytest.approx(1)
    assert "first bottleneck" in forecast_lines(found)


def test_the_bottleneck_is_the_part_that_takes_most() -> None:
    assert forecast(dataclasses.replace(PARTS, commit_ms=1900), 1000, 10**7).bottleneck == "commits"
    assert forecast(dataclasses.replace(PARTS, call_us=2000), 1000, 10**7).bottleneck == "calls to workers"
    assert forecast(dataclasses.replace(PARTS, task_s=0.5), 1000, 10**7).bottleneck == "rows of tasks"


def test_a_driver_that_cannot_keep_up_at_all_is_said() -> None:
    assert forecast(dataclasses.replace(PARTS, commit_ms=4000), 1000, 10**7).shortest_task_s == float("inf")


def test_parts_that_are_none_are_refused() -> None:
    with pytest.raises(ValueError, match="positive"):
        forecast(dataclasses.replace(PARTS, task_s=0), 1000, 10**7)
    with pytest.raises(ValueError, match="positive"):
        forecast(PARTS, 0, 10**7)
