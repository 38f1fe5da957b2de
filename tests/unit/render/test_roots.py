"""Root finding in brackets: correct, safeguarded, and with few evaluations."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from shift3d.render.solvers.roots import find_roots

FUNCTIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "line": lambda k: 0.3 - k,
    "cubic": lambda k: -((k - 0.7) ** 3),
    "steep": lambda k: -torch.expm1(40.0 * (k - 0.9)),
    "flat then steep": lambda k: 1e-3 - k**9,
    "step": lambda k: torch.where(k < 0.123, 1.0, -1.0).double(),
    "saturated": lambda k: torch.tanh(200.0 * (0.51 - k)),
    "square root": lambda k: 0.6 - k.sqrt(),
    "three roots": lambda k: -(k - 0.25) * (k - 0.47) * (k - 0.8),
}


def solve(f: Callable[[Tensor], Tensor], tolerance: float = 1e-9, iterations: int = 200):  # type: ignore[no-untyped-def]
    a, b = torch.zeros(1).double(), torch.ones(1).double()
    return find_roots(lambda k, rows: f(k), a, b, f(a), f(b), tolerance, iterations)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_answer_is_a_change_of_sign(name: str) -> None:
    f = FUNCTIONS[name]
    roots = solve(f)
    assert bool(roots.converged)
    k = roots.k
    eps = 1e-2 if name == "flat then steep" else 1e-6
    if name != "cubic":
        assert float(f((k - eps).clamp_min(0))) > 0 > float(f(k + eps))
    assert float(roots.residual) <= 1e-9 or name == "step"


def test_never_slower_than_four_times_bisection() -> None:
    for name, f in FUNCTIONS.items():
        calls = 0

        def counted(k: Tensor, rows: Tensor, f: Callable[[Tensor], Tensor] = f) -> Tensor:
            nonlocal calls
            calls += 1
            return f(k)

        a, b = torch.zeros(1).double(), torch.ones(1).double()
        find_roots(counted, a, b, f(a), f(b), 1e-9, 400)
        assert calls <= 4 * 40 + 5, name


def test_few_evaluations_on_distances_over_a_short_bracket() -> None:
    # Distances to spheres along skewed rays over 5 cm, the renderer's usual case.
    generator = torch.Generator().manual_seed(0)
    offset = torch.rand(1000, generator=generator, dtype=torch.float64) * 0.9
    distance = lambda k, rows: ((2.0 - k) ** 2 + offset[rows] ** 2).sqrt() - 1.0  # noqa: E731
    root = 2.0 - (1.0 - offset**2).sqrt()
    outer, inner = root - 0.02, root + 0.02
    rows = torch.arange(1000)
    count = 0

    def counted(k: Tensor, rows: Tensor) -> Tensor:
        nonlocal count
        count += len(k)
        return distance(k, rows)

    found = find_roots(counted, outer, inner, distance(outer, rows), distance(inner, rows), 1e-5, 40)
    assert float((found.k - root).abs().max()) < 1e-4
    assert count / 1000 < 3.0


def test_an_exact_root_at_the_outer_end_is_the_answer() -> None:
    a, b = torch.zeros(1).double(), torch.ones(1).double()
    found = find_roots(lambda k, rows: -k, a, b, a, -b, 1e-9, 10)
    assert float(found.k) == 0.0 and bool(found.converged)


def test_running_out_of_iterations_is_reported() -> None:
    found = solve(FUNCTIONS["step"], iterations=3)
    assert not bool(found.converged)


def test_nothing_to_do() -> None:
    empty = torch.empty(0, dtype=torch.float64)
    assert len(find_roots(lambda k, rows: k, empty, empty, empty, empty, 1e-9, 5).k) == 0
