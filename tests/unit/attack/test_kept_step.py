"""Which step of a search is kept: the lowest loss, alone or with its neighbours."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from shift3d.attack.loop import kept_step
from shift3d.attack.records import StepRecord
from shift3d.placement.constraints import ConstraintCheck

LOSSES = st.lists(st.sampled_from([0.0, 0.5, 1.0, 2.0, math.inf, math.nan]), min_size=1, max_size=8)


def path(losses: list[float], invalid: tuple[int, ...] = ()) -> list[StepRecord]:
    checks = [ConstraintCheck(0.0, 0.0, 400, step not in invalid, True, True) for step in range(len(losses))]
    return [StepRecord(i, (0.0,) * 6, 0.0, loss, loss, 0.5, checks[i], 0, 0.0, 1) for i, loss in enumerate(losses)]


def test_the_lowest_loss_is_kept_and_the_start_does_not_count() -> None:
    assert kept_step(path([0.0, 5.0, 3.0, 4.0])) == 2
    assert kept_step(path([0.0, 5.0, 3.0, 3.0])) == 2, "the first of equals"
    assert kept_step(path([0.0, 5.0, 3.0, 4.0], invalid=(2,))) == 3
    assert kept_step(path([0.0, 5.0], invalid=(1,))) == 0
    assert kept_step(path([0.0])) == 0


def test_a_narrow_dip_loses_against_a_wide_one() -> None:
    losses = [9.0, 9.0, 1.0, 9.0, 4.0, 3.0, 4.0, 9.0]
    assert kept_step(path(losses)) == 2
    assert kept_step(path(losses), steady_steps=1) == 5
    assert kept_step(path(losses, invalid=(5,)), steady_steps=1) == 1, "9 wherever one looks: the first"
    assert kept_step(path(losses, invalid=(4,)), steady_steps=1) == 5, "a neighbour need not be valid"


def test_at_both_ends_there_are_fewer_neighbours() -> None:
    assert kept_step(path([9.0, 2.0, 3.0, 8.0, 8.0]), steady_steps=1) == 1, "the start left out"
    assert kept_step(path([0.0, 8.0, 8.0, 3.0, 2.0]), steady_steps=1) == 4
    assert kept_step(path([0.0, 8.0, 8.0, 3.0, 2.0]), steady_steps=40) == 1, "all alike: the first"


@given(LOSSES, st.sets(st.integers(1, 7)), st.integers(0, 9))
def test_whatever_the_losses_are_a_kept_step_is_valid_and_has_one(
    losses: list[float], invalid: set[int], steady_steps: int
) -> None:
    kept = kept_step(path(losses, tuple(invalid)), steady_steps)
    assert kept == 0 or (kept not in invalid and math.isfinite(losses[kept]))
    if steady_steps == 0:
        usable = [step for step in range(1, len(losses)) if step not in invalid and math.isfinite(losses[step])]
        assert kept == min(usable, key=lambda step: losses[step], default=0)
