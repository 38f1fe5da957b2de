"""The first of two calls with the same tasks counts; only an unusually slow call gets a second one."""

from __future__ import annotations

from shift3d.sweep.execution.ray.calls import Call, Calls
from shift3d.sweep.execution.ray.worker_pool import PooledWorker


def call(reference: str, positions: list[int], ago_s: float = 0.0, copy: Call | None = None) -> Call:
    found = Call(reference, PooledWorker(None), positions, 1, copy=copy)
    found.began -= ago_s
    if copy:
        copy.copy = found
    return found


def test_the_second_of_two_copies_is_not_wanted() -> None:
    calls = Calls(least_s=1.0)
    calls.add(first := call("a", [1]))
    calls.add(second := call("b", [1], copy=first))
    assert first.worker.running and len(calls) == 2
    assert calls.pop("b") == (second, True)
    calls.finished(second, 1, 0.1)
    assert len(calls) == 0, "nobody waits for the other one"
    assert calls.references == ["a"]
    assert calls.pop("a") == (first, False)
    assert not first.worker.running


def test_a_copy_that_died_leaves_the_other_one_wanted() -> None:
    calls = Calls(least_s=1.0)
    calls.add(first := call("a", [1]))
    calls.add(second := call("b", [1], copy=first))
    assert calls.pop("b") == (second, True)
    assert calls.copy_of(second) is first and calls.copy_of(first) is None
    assert calls.pop("a") == (first, True)


def test_only_what_is_far_beyond_the_usual_straggles() -> None:
    calls = Calls(least_s=1.0)
    calls.add(late := call("a", [1, 2], ago_s=50))
    assert calls.straggler() is None, "nothing has ended: nobody knows what is usual"
    for _ in range(5):
        calls.finished(call("x", [0]), tasks=1, seconds=10.0)
    assert calls.straggler() is None, "two tasks take twenty seconds, three times that is sixty"
    late.began -= 20
    assert calls.straggler() is late
    calls.add(call("b", [1, 2], copy=late))
    assert calls.straggler() is None, "a second one is enough"


def test_of_quick_tasks_none_straggles_at_once() -> None:
    calls = Calls(least_s=5.0)
    calls.finished(call("x", [0]), tasks=100, seconds=0.01)
    calls.add(call("a", [1], ago_s=4))
    assert calls.straggler() is None
