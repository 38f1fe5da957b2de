"""A sweep stops early if its failures are systematic, and only then."""

from __future__ import annotations

import pytest

from shift3d.sweep.execution.abort import AbortedError, AbortRule
from shift3d.sweep.execution.worker import BatchOutcome


def failed(*errors: str) -> BatchOutcome:
    return BatchOutcome(quarantined=[str(number) for number in range(len(errors))], errors=list(errors))


def done(count: int) -> BatchOutcome:
    return BatchOutcome(done=[str(number) for number in range(count)])


def test_first_tasks_that_fail_alike_stop_it_with_the_error_and_the_remedy() -> None:
    rule = AbortRule(after=3, share=None)
    assert rule.seen(failed("ValueError: no such sensor: hdl65")) is None
    assert rule.seen(failed("ValueError: no such sensor: hdl65")) is None
    error = rule.seen(failed("ValueError: no such sensor: hdl65"))
    assert isinstance(error, AbortedError) and error.exit_code not in (0, 2, 3, 4)
    assert "first 3 tasks failed alike: ValueError: no such sensor: hdl65" in str(error)
    assert "--retry-quarantined" in str(error) and "runner.abort_after=null" in str(error)


@pytest.mark.parametrize(
    "outcomes",
    [
        [failed("ValueError: a"), failed("KeyError: a"), failed("ValueError: b")],  # not alike
        [done(1), failed(*["ValueError: a"] * 10)],  # one succeeded
        [failed("ValueError: a", "ValueError: a"), done(40)],
    ],
)
def test_other_failures_go_on(outcomes: list[BatchOutcome]) -> None:
    rule = AbortRule(after=3, share=0.02)
    assert [rule.seen(outcome) for outcome in outcomes] == [None] * len(outcomes)


def test_a_share_of_failures_stops_it_once_there_are_enough_to_tell() -> None:
    rule = AbortRule(after=None, share=0.02)
    assert rule.seen(done(40)) is None
    assert rule.seen(failed("ValueError: a")) is None, "too few tasks to tell"
    assert rule.seen(done(59)) is None
    assert rule.seen(failed("ValueError: b")) is None, "2 of 101 is less than 2 %"
    error = rule.seen(failed("KeyError: c"))
    assert error and "3 of 102 tasks failed, more than 2%" in str(error)


def test_switched_off_it_never_stops() -> None:
    rule = AbortRule(after=None, share=None)
    assert rule.seen(failed(*["ValueError: a"] * 100)) is None
