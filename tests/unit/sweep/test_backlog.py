"""Every task is handed out once unless it comes back, and is charged only for its own failures."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from shift3d.sweep.execution.backlog import Backlog


def died(backlog: Backlog, positions: list[int], culprit: int | None = None, copied: bool = False) -> bool:
    return backlog.failed(positions, culprit, charged=True, apart=culprit is None, copied=copied)


def lost(backlog: Backlog) -> bool:
    return backlog.failed([0], culprit=0, charged=False, apart=False, copied=False)


def test_tasks_are_handed_out_in_order_and_once() -> None:
    backlog = Backlog([3, 5, 8, 9])
    assert (backlog.take(3), len(backlog)) == ([3, 5, 8], 1)
    assert (backlog.take(3), len(backlog)) == ([9], 0)
    assert backlog.take(3) == []


def test_what_comes_back_goes_first_and_suspects_go_alone() -> None:
    backlog = Backlog(range(10))
    backlog.take(4)
    died(backlog, [0, 1])
    assert not backlog.failed([2, 3], culprit=None, charged=False, apart=False, copied=False)
    assert [backlog.take(3) for _ in range(4)] == [[0], [1], [2, 3, 4], [5, 6, 7]]
    assert len(backlog) == 2


def test_a_task_is_given_up_on_at_its_second_charge_and_a_lost_machine_is_none() -> None:
    backlog = Backlog([0])
    assert [lost(backlog), died(backlog, [0], 0), lost(backlog), died(backlog, [0], 0)] == [False, False, False, True]


def test_a_task_under_which_machine_after_machine_goes_away_is_given_up_on() -> None:
    backlog = Backlog([0])
    assert [lost(backlog) for _ in range(6)] == [False] * 5 + [True]


def test_a_known_culprit_goes_alone_and_the_others_stay_together() -> None:
    backlog = Backlog(range(4))
    backlog.take(3)
    assert not backlog.failed([0, 1, 2], culprit=1, charged=True, apart=False, copied=False)
    assert [backlog.take(3) for _ in range(2)] == [[1], [0, 2, 3]]


def test_while_a_copy_runs_nothing_comes_back_and_a_task_is_quarantined_once() -> None:
    backlog = Backlog([0])
    assert backlog.take(1) == [0]
    assert not died(backlog, [0], 0)
    assert backlog.take(1) == [0]
    assert not died(backlog, [0], 0, copied=True), "the copy may succeed"
    assert len(backlog) == 0
    assert died(backlog, [0], 0), "the copy did not"
    assert len(backlog) == 0


def test_attempts_are_numbered_on() -> None:
    backlog = Backlog([0, 1, 2], tried={1: 2})
    assert backlog.first_attempt([0]) == 1
    assert backlog.first_attempt([0, 1]) == 3
    backlog.tried([0, 1], 3)
    assert backlog.first_attempt([0]) == backlog.first_attempt([1]) == 4
    assert backlog.first_attempt([2]) == 1


def test_each_worker_has_a_stretch_of_the_plan_to_itself_and_helps_where_most_is_left() -> None:
    backlog = Backlog(range(16))
    assert backlog.take(2, "a") == [0, 1]
    assert backlog.take(2, "b") == [9, 10]  # the later half of the tasks left to "a"
    assert backlog.take(2, "a") == [2, 3]
    assert backlog.take(8, "b") == [11, 12, 13, 14, 15]
    assert backlog.take(8, "b") == [6, 7, 8]
    assert [backlog.take(8, worker) for worker in ("a", "b", "c")] == [[4, 5], [], []]


@given(st.lists(st.tuples(st.sampled_from("abcd"), st.integers(1, 9)), max_size=60), st.integers(0, 50))
def test_whoever_takes_how_many_every_task_is_handed_out_once(turns: list[tuple[str, int]], count: int) -> None:
    backlog = Backlog(range(count))
    taken: list[int] = []
    for worker, size in turns:
        found = backlog.take(size, worker)
        assert found or not len(backlog)
        taken += found
    while len(backlog):
        taken += backlog.take(1, "e")
    assert sorted(taken) == list(range(count))
