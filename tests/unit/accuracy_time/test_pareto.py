"""Dominated settings by hand and against a plain reference, and the bound that their combined error gives."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from frontier_by_hand import frontier_row, with_depth

from shift3d.accuracy_time.pareto import (
    dominating_rows,
    effective_error_m,
    knee,
    log_axis_errors,
    misplaced_share,
    pareto_flags,
    warm_starts,
)


def columns(**changes: float) -> dict[str, list[float]]:
    row = dict.fromkeys(
        ("depth_p50_m", "depth_p99_m", "depth_max_m", "missed_hits", "wrong_surface", "false_hits"), 0.0
    )
    return {name: [value] for name, value in (row | changes).items()}


def test_the_error_by_hand() -> None:
    one = columns(
        depth_p50_m=0.002, depth_p99_m=0.01, depth_max_m=0.5, missed_hits=0.01, wrong_surface=0.02, false_hits=0.04
    )
    assert effective_error_m(one) == pytest.approx([0.001 + 0.0049 + 0.005 + 0.07])
    assert misplaced_share(one) == pytest.approx([0.03])
    assert effective_error_m(columns()) == [0.0]


@pytest.mark.parametrize("name", list(columns()))
def test_no_way_of_being_wrong_goes_uncounted(name: str) -> None:
    assert effective_error_m(columns(**{name: 1e-3}))[0] >= 1e-5


@pytest.mark.parametrize("seed", range(20))
def test_the_error_bounds_the_mean_error_of_a_beam(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true_hits, wrong_beams = 2000, int(rng.integers(0, 50))
    depth = 10.0 ** rng.uniform(-9, rng.uniform(-8, 0), true_hits - wrong_beams)
    p50, p99 = np.quantile(depth, (0.5, 0.99), method="higher")
    bound = effective_error_m(
        columns(depth_p50_m=p50, depth_p99_m=p99, depth_max_m=depth.max(), missed_hits=wrong_beams / true_hits)
    )
    assert (depth.sum() + wrong_beams * 1.0) / true_hits <= bound[0] * (1 + 1e-12)


def test_the_limits_of_standard_weigh_the_same() -> None:
    # 0.01 % misplaced; 99th percentile 0.1 mm (the median at most that), maximum 1 mm.
    misplacing = effective_error_m(columns(missed_hits=1e-4))[0]
    depths = effective_error_m(columns(depth_p50_m=1e-4, depth_p99_m=1e-4, depth_max_m=1e-3))[0]
    assert misplacing == pytest.approx(1e-4) and depths == pytest.approx(1.09e-4)


def test_dominated_rows_and_by_whom() -> None:
    #       a    b    c    d    e    f
    time = [1.0, 2.0, 3.0, 4.0, 2.5, 5.0]
    error = [9.0, 5.0, 5.0, 1.0, 6.0, 7.0]
    # c has b's error and takes longer; e is worse than b in both; f is worse than b, c, d and e: b is the fastest.
    assert dominating_rows(time, error).tolist() == [-1, -1, 1, -1, 1, 1]


def test_of_several_dominators_the_fastest_that_is_at_least_as_accurate_then_the_most_accurate() -> None:
    assert dominating_rows([1, 2, 2, 3], [8, 4, 3, 4]).tolist() == [-1, 2, -1, 2]
    assert dominating_rows([2, 2, 3], [3, 3, 4]).tolist() == [-1, -1, 0]


def test_ties_are_on_the_front_together_or_behind_it_together() -> None:
    assert dominating_rows([1, 1, 1], [2, 2, 2]).tolist() == [-1, -1, -1]
    assert dominating_rows([1, 1, 2, 2], [2, 2, 3, 3]).tolist() == [-1, -1, 0, 0]
    # A tie in one column is decided by the other.
    assert dominating_rows([1, 1], [2, 3]).tolist() == [-1, 0]
    assert dominating_rows([1, 2], [3, 3]).tolist() == [-1, 0]


def test_a_warm_row_takes_no_cold_row_off_the_front() -> None:
    time, error, warm = [2.0, 1.0, 3.0, 4.0], [5.0, 5.0, 4.0, 6.0], [False, True, True, False]
    # Row 3 is cold and worse than cold row 0; warm row 1 is faster, but has no rendering to start from.
    assert dominating_rows(time, error, warm).tolist() == [-1, -1, -1, 0]
    assert dominating_rows(time, error).tolist() == [1, -1, -1, 1]
    # A better cold row makes a warm row pointless.
    assert dominating_rows([1.0, 2.0], [1.0, 2.0], [False, True]).tolist() == [-1, 0]


def plain_front(time: npt.NDArray[np.int64], error: npt.NDArray[np.int64]) -> list[bool]:
    front = []
    for i in range(len(time)):
        beaten = False
        for j in range(len(time)):
            beaten |= bool(time[j] <= time[i] and error[j] <= error[i] and (time[j] < time[i] or error[j] < error[i]))
        front.append(not beaten)
    return front


@pytest.mark.parametrize("seed", range(30))
def test_the_front_is_that_of_the_plain_reference_whatever_the_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time, error = rng.integers(0, 6, (2, int(rng.integers(1, 25))))  # small numbers, so that ties occur
    by = dominating_rows(time, error)
    assert (by < 0).tolist() == plain_front(time, error)
    assert all(by[winner] < 0 for winner in by[by >= 0])  # every dominating row is on the front
    order = rng.permutation(len(time))
    assert ((dominating_rows(time[order], error[order]) < 0) == (by < 0)[order]).all()


def test_a_time_or_an_error_that_is_no_number_is_refused() -> None:
    for time, error in (([1.0, np.nan], [1.0, 1.0]), ([1.0, 1.0], [np.inf, 1.0])):
        with pytest.raises(ValueError, match="not finite"):
            dominating_rows(time, error)
    with pytest.raises(ValueError, match=r"\(N,\)"):
        dominating_rows([1.0, 2.0], [1.0])


def test_flags_are_of_each_scene_set_alone() -> None:
    rows = [
        frontier_row("draft", 1.0, **with_depth(1e-3)),
        frontier_row("march", 2.0, **with_depth(2e-3)),
        frontier_row("march", 2.0, scenes="kitti", **with_depth(2e-3)),
        frontier_row("standard, warm", 0.5, **with_depth(1e-5)),
        frontier_row("standard", 3.0, **with_depth(1e-5)),
    ]
    assert pareto_flags(rows) == [True, False, True, True, True]
    assert pareto_flags([]) == []
    names = ["standard, warm", "warm start 20", "standard", "swarm"]
    assert warm_starts({"setting": names}).tolist() == [True, True, False, False]
    starts = ["cold", "warm", "warm", None]
    assert warm_starts({"setting": names, "start": starts}).tolist() == [False, True, True, False]


def test_the_knee_is_the_corner_and_knows_no_units() -> None:
    time, error = np.array([1.0, 2.0, 100.0, 1000.0]), np.array([1e-1, 1e-5, 1e-6, 1e-7])
    assert knee(time, error) == 1
    order = [3, 0, 2, 1]
    assert knee(1e3 * time[order], 1e-3 * error[order]) == 3


def test_no_knee_on_a_straight_a_bulging_or_a_short_front() -> None:
    assert knee([1, 10, 100], [1e-1, 1e-2, 1e-3]) is None
    assert knee([1, 10, 100], [1e-1, 0.9e-1, 1e-3]) is None
    assert knee([1, 100], [1e-1, 1e-3]) is None
    assert knee([1, 1, 1], [1e-3, 1e-3, 1e-3]) is None


def test_an_error_of_zero_is_where_the_diagram_has_it() -> None:
    assert log_axis_errors([0.0, 3e-6, 1e-2], 1.0) == pytest.approx([1e-7, 3e-6, 1e-2])
    assert log_axis_errors([0.0, 0.0], 3e-9) == pytest.approx([1e-10, 1e-10])
    assert knee([1.0, 2.0, 1000.0], [1e-2, 3e-6, 0.0]) == 1


def test_a_row_is_dominated_only_by_what_has_its_conditions_and_does_its_work() -> None:
    time, error = [1.0, 2.0, 3.0], [1.0, 1.0, 1.0]
    # With grids: row 0 cannot replace row 1, which has no grid, but row 1 can replace row 2.
    assert dominating_rows(time, error, grid=[True, False, True]).tolist() == [-1, -1, 0]
    assert dominating_rows(time, error, grid=[True, False, False]).tolist() == [-1, -1, 1]
    # A rendering ready for a gradient takes longer than one that is not, and can replace it.
    assert dominating_rows(time, error, gradient=["no", "shape", "shape"]).tolist() == [-1, -1, 1]
    assert dominating_rows(time, error, gradient=["pose", "shape", "no"]).tolist() == [-1, -1, 0]
    rows = [frontier_row("cold", 1.0, grid=True), frontier_row("without grid", 2.0), frontier_row("slower", 3.0)]
    assert pareto_flags(rows) == [True, True, False]
