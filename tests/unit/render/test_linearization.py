"""Hits predicted from the derivatives of the step before, and gradients from these same derivatives."""

from collections.abc import Callable

import torch
from analytic_fields import SHAPENET_FRAME, Frame, in_frame, sector_scan, soft_car
from torch import Tensor

from shift3d.render import Beams, Rendering, preset, render
from shift3d.render.culling import object_rays
from shift3d.render.field.object_field import Field as AnyField
from shift3d.render.field.object_field import ObjectField
from shift3d.render.solvers.corrector import predict
from shift3d.sdf.decoder import load_decoder
from shift3d.sdf.field import Field
from shift3d.vehicles.vehicle import baseline_vehicles

STANDARD = preset("standard").with_(dtype=torch.float64)
SUV = baseline_vehicles()["suv"]
DECODER = load_decoder().double()
CODE = torch.from_numpy(SUV.latent_code).double()
THETA = torch.tensor([14.0, 1.0, 0.0, 0.6, 0.02, -0.03], dtype=torch.float64)


def beams(rays: int = 16) -> Beams:
    return Beams.from_arrays(*sector_scan((14.0, 1.0, -0.3), half_angle_rad=0.12, rays=rays, far_m=30.0))


def insert(
    code: Tensor,
    theta: Tensor = THETA,
    warm: Rendering | None = None,
    through: Callable[[Field], AnyField] = lambda field: field,
) -> Rendering:
    """Render the SUV of a code at a pose, warm from another rendering."""
    field = through(DECODER.field(code))
    return render(beams(), field, theta, SUV, STANDARD, None if warm is None else warm.warm)


def toward(rendering: Rendering, *inputs: Tensor) -> list[Tensor]:
    """Return gradients of a loss that weighs every hit differently."""
    points = rendering.points[rendering.hit_mask]
    return list(torch.autograd.grad((points * points.detach().sin()).sum(), inputs))


def test_gradients_are_the_plain_ones() -> None:
    """A decoder's closed form is compared with autograd through the whole decoder, which any other field uses."""
    found = []
    for through in (lambda field: field, lambda field: lambda x: field(x)):
        code, theta = CODE.clone().requires_grad_(), THETA.clone().requires_grad_()
        rendering = insert(code, theta, through=through)
        assert rendering.object_points > 100
        found.append(toward(rendering, code, theta))
    for closed, plain in zip(*found, strict=True):
        assert torch.allclose(closed, plain, rtol=1e-9, atol=1e-9 * float(plain.abs().max()))


def test_gradients_of_a_followed_rendering_are_those_of_a_fresh_one() -> None:
    step = 0.01 * torch.randn(CODE.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    first = insert(CODE.clone().requires_grad_())
    code, again = (CODE + step).requires_grad_(), (CODE + step).requires_grad_()
    followed, fresh = insert(code, warm=first), insert(again)
    assert torch.equal(followed.hit_mask, fresh.hit_mask)
    ours, theirs = toward(followed, code)[0], toward(fresh, again)[0]
    assert float(torch.nn.functional.cosine_similarity(ours, theirs, dim=0)) > 0.999
    off = (followed.range_m - fresh.range_m).detach().abs()
    assert float(off.quantile(0.99)) < 1e-4 and float(off.max()) < 1e-3


def test_small_steps_of_code_and_pose_are_predicted() -> None:
    """The prediction covers most of the distance, and three of four hits are within a millimetre."""
    direction = torch.randn(CODE.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    theta = THETA + torch.tensor([0.01, -0.005, 0.01, 0.002, 0.001, 0.0], dtype=torch.float64)
    first = insert(CODE.clone().requires_grad_())
    code = CODE + 0.001 * direction
    fresh = insert(code, theta)
    known = first.warm.linearization
    assert known is not None and len(known) == first.object_points
    field = ObjectField.of(DECODER.field(code), SUV, torch.float64, 4096)
    expected, _ = predict(known, object_rays(beams(), known.index, theta), field)
    both = fresh.hit_mask[known.index]
    found = fresh.range_m[known.index][both]
    moved = (found - first.range_m.detach()[known.index][both]).abs()
    off = (found - expected[both]).abs()
    assert float(moved.median()) > 3e-3
    assert float(off.median()) < 0.1 * float(moved.median())
    assert float((off < 1e-3).double().mean()) > 0.75


def test_a_plate_is_predicted_exactly() -> None:
    """The derivatives predict the face up to the curvature of tanh, because g is linear in place and bias."""
    weight = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], dtype=torch.float64)
    out = torch.ones(1, 2, dtype=torch.float64)

    def plate(half: float) -> Field:
        thickness = torch.tensor([-half], dtype=torch.float64).requires_grad_()
        return Field([weight, out], [torch.zeros(2, dtype=torch.float64), thickness], skip_layer=-1)

    scan = Beams.from_arrays(*sector_scan((10.0, 0.0, 0.0), half_angle_rad=0.04, rays=8, far_m=30.0))
    theta, frame = torch.tensor([10.0, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64), Frame(scale_m=2.5)
    first, cold = (render(scan, plate(half), theta, frame, STANDARD) for half in (0.1, 0.11))
    warm = render(scan, plate(0.11), theta, frame, STANDARD, first.warm)
    assert first.object_points == warm.object_points == 64
    assert float((warm.range_m - first.range_m).detach().abs().min()) > 0.024
    assert warm.max_residual_m < 1e-5
    assert float((warm.range_m - cold.range_m).detach().abs().max()) < 1e-8


def test_a_code_that_no_formula_knows_is_followed_all_the_same() -> None:
    """The code's part is not predicted if the field is no decoder; its gradient is that of a cold rendering."""
    start = torch.tensor([0.3, -0.2, 0.1, 0.5, -0.4, 0.8], dtype=torch.float64)
    warm = None
    for step in range(3):
        code = (start + 0.01 * step).requires_grad_()
        field = in_frame(soft_car(code), SHAPENET_FRAME)
        followed, fresh = (render(beams(), field, THETA, SHAPENET_FRAME, STANDARD, known) for known in (warm, None))
        assert followed.object_points == fresh.object_points > 50
        ours, theirs = toward(followed, code)[0], toward(fresh, code)[0]
        assert float((ours - theirs).norm()) < 1e-3 * float(theirs.norm())
        warm = followed.warm
        assert warm is not None and warm.linearization is not None and warm.linearization.graph is None
