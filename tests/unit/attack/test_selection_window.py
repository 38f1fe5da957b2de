"""The step that a search keeps: the lowest loss, alone or with its neighbours."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from shift3d.attack.loop import best_step
from shift3d.attack.records import StepRecord
from shift3d.placement.constraints import ConstraintCheck

LOSSES = st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0, math.inf, math.nan]), min_size=1, max_size=8)


def path(losses: list[float], invalid: tuple[int, ...] = ()) -> list[StepRecord]:
    checks = [ConstraintCheck(0.0, 0.0, 400, step not in invalid, True, True) for step in range(len(losses))]
    return [StepRecord(i, (0.0,) * 6, 0.0, loss, loss, 0.5, checks[i], 0, 0.0, 1) for i, loss in enumerate(losses)]


def test_the_lowest_loss_is_kept_and_the_start_does_not_count() -> None:
    assert best_step(path([0.0, 5.0, 3.0, 4.0])) == 2
    assert best_step(path([0.0, 5.0, 3.0, 3.0])) == 2, "the first of equals"
    assert best_step(path([0.0, 5.0, 3.0, 4.0], invalid=(2,))) == 3
    assert best_step(path([0.0, 5.0], invalid=(1,))) == 0
    assert best_step(path([0.0])) == 0


def test_a_narrow_dip_loses_against_a_wide_one() -> None:
    losses = [9.0, 9.0, 1.0, 9.0, 4.0, 3.0, 4.0, 9.0]
    assert best_step(path(losses)) == 2
    assert best_step(path(losses), selection_window=1) == 5
    assert best_step(path(losses, invalid=(5,)), selection_window=1) == 1, "9 wherever one looks: the first"
    assert best_step(path(losses, invalid=(4,)), selection_window=1) == 5, "a neighbour need not be valid"


def test_at_both_ends_there_are_fewer_neighbours() -> None:
    assert best_step(path([9.0, 2.0, 3.0, 8.0, 8.0]), selection_window=1) == 1, "the start left out"
    assert best_step(path([0.0, 8.0, 8.0, 3.0, 2.0]), selection_window=1) == 4
    assert best_step(path([0.0, 8.0, 8.0, 3.0, 2.0]), selection_window=40) == 1, "all alike: the first"


@given(LOSSES, st.sets(st.integers(1, 7)), st.integers(0, 9))
def test_whatever_the_losses_are_the_best_step_is_valid_and_has_one(
    losses: list[float], invalid: set[int], selection_window: int
) -> None:
    kept = best_step(path(losses, tuple(invalid)), selection_window)
    assert kept == 0 or (kept not in invalid and math.isfinite(losses[kept]))
    if selection_window == 0:
        usable = [step for step in range(1, len(losses)) if step not in invalid and math.isfinite(losses[step])]
        assert kept == min(usable, key=lambda step: losses[step], default=0)
