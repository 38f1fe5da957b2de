"""Times are taken in turns, without the garbage collector, and more often where more precision is worth it."""

from __future__ import annotations

import gc
import json
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shift3d.accuracy_time.timing import interleaved_samples, machine, milliseconds, num_further_timings


def test_settings_take_turns_and_every_second_round_runs_backwards() -> None:
    assert list(interleaved_samples({"a": 2, "b": 2, "c": 2})) == [
        ("a", 0),
        ("b", 0),
        ("c", 0),
        ("c", 1),
        ("b", 1),
        ("a", 1),
    ]


@settings(max_examples=40)
@given(wanted=st.dictionaries(st.text(min_size=1, max_size=3), st.integers(0, 12), max_size=6))
def test_everybody_gets_what_it_wants_in_order_and_spread_over_the_run(wanted: dict[str, int]) -> None:
    order = list(interleaved_samples(wanted))
    rounds = max(wanted.values(), default=0)
    for name, count in wanted.items():
        mine = [number for found, number in order if found == name]
        assert mine == list(range(count))
        if count == 1:  # in the middle, not at an end
            others = [found for found, _ in order[: order.index((name, 0))]]
            assert all(
                rounds // 2 <= others.count(other) <= rounds // 2 + 1 for other in wanted if wanted[other] == rounds > 1
            )


def test_drift_of_the_machine_hits_all_alike() -> None:
    # A machine that takes one unit longer with every call: means over turns differ by less than a round.
    spent: dict[str, list[int]] = {"a": [], "b": [], "c": []}
    for clock, (name, _) in enumerate(interleaved_samples(dict.fromkeys(spent, 6))):
        spent[name].append(clock)
    means = [sum(values) / len(values) for values in spent.values()]
    assert max(means) - min(means) < 1e-9


@pytest.mark.parametrize(
    ("first_ms", "expected"),
    [(1.0, 7), (400.0, 7), (1000.0, 3), (2900.0, 1), (29_000.0, 1), (31_000.0, 0)],
)
def test_slow_ones_are_timed_less_often_and_very_slow_ones_not_again(first_ms: float, expected: int) -> None:
    assert num_further_timings(first_ms, most=7, seconds=3.0, slow_s=30.0) == expected


def test_no_garbage_is_collected_inside_and_the_collector_comes_back() -> None:
    states = []
    assert gc.isenabled()
    assert milliseconds(lambda: (states.append(gc.isenabled()), time.sleep(0.01))) >= 10.0
    assert states == [False] and gc.isenabled()
    with pytest.raises(RuntimeError):
        milliseconds(_fails)
    assert gc.isenabled()


def _fails() -> None:
    raise RuntimeError


def test_the_machine_is_described_without_a_date_or_a_name() -> None:
    assert machine() == machine()
    json.dumps(machine(), allow_nan=False)
    assert {"processor", "cores", "torch", "threads"} <= machine().keys()
    assert not {"host", "user", "date", "time"} & machine().keys()
