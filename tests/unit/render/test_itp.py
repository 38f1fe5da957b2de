"""ITP and bisection in brackets: right, and within their worst cases whatever the function does."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shift3d.render.itp import SLACK, find_roots_bisection, find_roots_itp
from torch import Tensor

from shift3d.render.roots import Roots

METHODS = {"itp": (find_roots_itp, SLACK), "bisection": (find_roots_bisection, 0)}


def counted(f: Callable[[Tensor, Tensor], Tensor], count: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    def call(k: Tensor, rows: Tensor) -> Tensor:
        count[rows] += 1
        return f(k, rows)

    return call


def power(root: Tensor, exponent: Tensor, scale: Tensor) -> Callable[[Tensor, Tensor], Tensor]:
    """Falls through zero at `root`: steep there for exponents below 1, flat above, a jump at 0."""

    def f(k: Tensor, rows: Tensor) -> Tensor:
        away = root[rows] - k
        return away.sign() * away.abs() ** exponent[rows] * scale[rows]

    return f


FUNCTION = st.tuples(
    st.floats(0.001, 0.999), st.sampled_from([0.0, 0.2, 0.5, 1.0, 2.0, 3.0, 9.0]), st.floats(1e-3, 1e3)
)


@pytest.mark.parametrize("method", METHODS)
@given(
    functions=st.lists(FUNCTION, min_size=1, max_size=8),
    start=st.floats(0.0, 60.0),
    width=st.floats(1e-3, 5.0),
    digits=st.integers(1, 7),
)
@settings(max_examples=150, deadline=None)
def test_the_root_is_found_within_the_worst_case(
    method: str, functions: list[tuple[float, float, float]], start: float, width: float, digits: int
) -> None:
    find, slack = METHODS[method]
    tolerance = 10.0**-digits
    share, exponent, scale = (torch.tensor(column, dtype=torch.float64) for column in zip(*functions))
    root = start + width * share
    rows = torch.arange(len(root))
    f = power(root, exponent, scale)
    outer, inner = torch.full_like(root, start), torch.full_like(root, start + width)
    count = torch.zeros(len(root), dtype=torch.long)
    found: Roots = find(counted(f, count), outer, inner, f(outer, rows), f(inner, rows), tolerance, 200)
    assert bool(found.settled.all())
    near = (found.k - root).abs() <= tolerance + 1e-9
    assert bool((near | (found.residual <= tolerance)).all())
    assert torch.allclose(found.residual, f(found.k, rows).abs(), rtol=1e-9, atol=0)
    exact_width = float((inner - outer)[0])
    assert int(count.max()) <= max(0, math.ceil(math.log2(exact_width / tolerance))) + slack


def test_itp_needs_less_than_half_of_the_evaluations_on_a_distance_over_a_short_bracket() -> None:
    generator = torch.Generator().manual_seed(0)
    offset = torch.rand(1000, generator=generator, dtype=torch.float64) * 0.9

    def distance(k: Tensor, rows: Tensor) -> Tensor:
        return ((2.0 - k) ** 2 + offset[rows] ** 2).sqrt() - 1.0

    root, rows = 2.0 - (1.0 - offset**2).sqrt(), torch.arange(1000)
    outer, inner = root - 0.07, root + 0.03
    spent = {}
    for name, (find, _) in METHODS.items():
        count = torch.zeros(1000, dtype=torch.long)
        ends = distance(outer, rows), distance(inner, rows)
        found = find(counted(distance, count), outer, inner, *ends, 1e-6, 60)
        assert float((found.k - root).abs().max()) < 1e-5
        spent[name] = float(count.double().mean())
    assert spent["itp"] < spent["bisection"] / 2


def test_brackets_may_run_either_way_and_an_exact_end_is_the_answer() -> None:
    for find, _ in METHODS.values():
        one, zero = torch.ones(1).double(), torch.zeros(1).double()
        backwards = find(lambda k, rows: k - 0.3, one, zero, 0.7 * one, -0.3 * one, 1e-9, 100)
        assert float(backwards.k) == pytest.approx(0.3, abs=1e-8)
        exact = find(lambda k, rows: -k, zero, one, zero, -one, 1e-9, 100)
        assert float(exact.k) == 0.0 and bool(exact.settled)


def test_running_out_of_iterations_is_reported() -> None:
    for find, _ in METHODS.values():
        a, b = torch.zeros(1).double(), torch.ones(1).double()
        found = find(lambda k, rows: torch.where(k < 0.3, 1.0, -1.0).double(), a, b, b, -b, 1e-9, 4)
        assert not bool(found.settled)
        assert float(found.k) == pytest.approx(0.3, abs=1 / 8)
