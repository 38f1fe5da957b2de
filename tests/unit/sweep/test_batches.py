"""Batches grow towards a few seconds of work, and the last ones are shared among workers."""

from __future__ import annotations

import itertools

from shift3d.sweep.execution.backlog import BatchSizer


def test_slow_tasks_go_one_at_a_time() -> None:
    sizer = BatchSizer(seconds=3.0)
    assert sizer.size(1000, 2) == 1
    sizer.finished(1, 20.0)
    assert sizer.size(1000, 2) == 1


def test_quick_tasks_grow_to_the_aim_and_not_at_once() -> None:
    sizer = BatchSizer(seconds=3.0)
    sizes = []
    for _ in range(6):
        size = sizer.size(10**6, 2)
        sizes.append(size)
        sizer.finished(size, 0.001 * size)
    assert sizes[0] == 1 and sizes == sorted(sizes)
    assert all(later <= 8 * earlier for earlier, later in itertools.pairwise(sizes))
    assert sizes[-1] == 3000


def test_the_last_tasks_are_shared_between_the_workers() -> None:
    sizer = BatchSizer(seconds=3.0)
    sizer.finished(1, 1e-6)
    for _ in range(5):
        sizer.size(10**6, 4)
    assert sizer.size(40, 4) == 10
    assert sizer.size(1, 4) == 1
