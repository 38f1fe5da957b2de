"""Floating-point operations: how many a step needs, and how many per second this processor reaches at best."""

from __future__ import annotations

from collections.abc import Callable

import torch
from benchmarks.timing import repeat
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from shift3d.attack.objective import ATTACK_RADIUS_M, adversarial_loss, object_box, to_network_frame, window_around
from shift3d.attack.problem import AttackProblem
from shift3d.render.rendering import Rendering
from shift3d.sdf.affine import affine

__all__ = [
    "counted",
    "decoder_pass",
    "detector_pass",
    "evaluation_flops",
    "gemm_peak_gflops",
    "gradient_flops",
]

_SIZES = (256, 512, 1024, 2048)


def gemm_peak_gflops(dtype: torch.dtype, budget_s: float) -> tuple[float, int]:
    """Measure the most GFLOP/s that a square matrix product reaches, and its size. One multiply-add is two operations.

    The library is the one that the decoder uses on this machine.
    """
    best = (0.0, 0)
    for size in _SIZES:
        a, b = torch.randn(size, size, dtype=torch.float64).to(dtype), torch.randn(size, size).to(dtype)

        def product(a: Tensor = a, b: Tensor = b) -> Tensor:
            return affine(a, b, None)

        milliseconds = repeat(product, budget_s / len(_SIZES)).best
        best = max(best, (2e-6 * size**3 / milliseconds, size))
    return best


def _affine_flops(x: tuple[int, ...], weight: tuple[int, ...], *_: object, **__: object) -> int:
    """Count operations of a product by oneDNN, which torch cannot count, from the shapes of its operands."""
    return 2 * x[0] * weight[0] * weight[1]


def counted(call: Callable[[], object]) -> int:
    """Count operations of the matrix products and convolutions in a call, as torch counts them."""
    mapping = {torch.ops.mkldnn._linear_pointwise: _affine_flops}
    with FlopCounterMode(display=False, custom_mapping=mapping) as counter:
        call()
    return int(counter.get_total_flops())


def decoder_pass(problem: AttackProblem, points: int, gradient: bool = False) -> Callable[[], object]:
    """Return a call of the decoder at `points` points of the vehicle, with or without the backward pass to them."""
    field = problem.field_of(problem.code0)
    x = torch.rand(points, 3, generator=torch.Generator().manual_seed(0)).to(problem.settings.dtype) - 0.5

    def call() -> object:
        with torch.set_grad_enabled(gradient):
            leaf = x.clone().requires_grad_(gradient)
            g = field(leaf)
            return torch.autograd.grad(g.sum(), leaf) if gradient else g

    return call


def evaluation_flops(problem: AttackProblem) -> float:
    """Return the operations of one evaluation of the decoder."""
    return counted(decoder_pass(problem, 1000)) / 1000


def gradient_flops(problem: AttackProblem) -> float:
    """Return the operations of the decoder forward and backward for one point, which a hit's derivative needs."""
    return counted(decoder_pass(problem, 1000, gradient=True)) / 1000


def detector_pass(problem: AttackProblem, rendering: Rendering, whole_scene: bool = False) -> Callable[[], object]:
    """Return a call of detector, loss and backward pass to the points: in an attack's window, or everywhere."""
    theta = problem.theta0
    points = to_network_frame(rendering.points.detach(), problem.ground_z_m)
    window = None if whole_scene else window_around(problem.detector, theta, ATTACK_RADIUS_M)
    box = object_box(theta, problem.vehicle.size_m, problem.ground_z_m)

    def call() -> object:
        leaf = points.clone().requires_grad_()
        loss = adversarial_loss(problem.detector.proposals(leaf, window), box)
        return torch.autograd.grad(loss, leaf)

    return call
