"""Codes far off the prior, random networks, fields that are positive everywhere or in pieces."""

import math

import numpy as np
import torch
from analytic_fields import SHAPENET_FRAME, Frame, in_frame, sphere, union
from hypothesis import assume, given
from hypothesis import strategies as st
from property_worlds import EXACT, FAST64, NUMBERS, draw, fan, few, known_to_m, poses, random_decoder, slopes
from torch import Tensor

from shift3d.geometry.se3 import object_from_scene, scene_from_object
from shift3d.render import Beams, preset, render
from shift3d.render.field.object_field import ObjectField
from shift3d.sdf.decoder import load_decoder
from shift3d.training.sdf.export import CODE_NORM
from shift3d.vehicles.vehicle import baseline_vehicles

DECODER, DECODER64 = load_decoder(), load_decoder().double()
SUV = baseline_vehicles()["suv"]
FEW_BEAMS = Beams.from_arrays(fan(6), np.zeros(3))
BEAMS = Beams.from_arrays(fan(12), np.zeros(3))


def metric_of_suv(code: Tensor, places: Tensor, theta: Tensor) -> Tensor:
    with torch.no_grad():
        x_sdf = torch.from_numpy(SUV.to_sdf(object_from_scene(places, theta).numpy()))
        return DECODER64(code.double().expand(len(places), -1), x_sdf) * SUV.scale_m


@few(12)
@given(times=st.floats(0.0, 20.0), number=NUMBERS, theta=poses())
def test_codes_up_to_twenty_times_the_priors_length(times: float, number: int, theta: Tensor) -> None:
    direction = torch.randn(256, generator=torch.Generator().manual_seed(number))
    code = (direction / direction.norm() * CODE_NORM * times).requires_grad_()
    pose = theta.clone().requires_grad_()
    settings = preset("standard")
    drawn = render(FEW_BEAMS, DECODER.field(code), pose, SUV, settings)
    assert torch.isfinite(drawn.points).all() and torch.isfinite(drawn.range_m).all()
    # The sensor is at least 12 m away: it is in no object, so no beam is unresolved.
    assert drawn.unresolved_beams == 0
    if drawn.object_points:
        drawn.points.sin().sum().backward()
        assert code.grad is not None and pose.grad is not None
        assert torch.isfinite(code.grad).all() and torch.isfinite(pose.grad).all()
        on_surface = metric_of_suv(code.detach(), drawn.points.detach()[drawn.hit_mask], theta)
        # The last step is not evaluated: up to final_newton_m along the beam, times the change of slope on the way, 1.
        bound_m = settings.tolerance_m + settings.reachable_residual_m(SUV.scale_m)
        assert float(on_surface.abs().max()) <= bound_m + settings.final_newton_m
        assert float(on_surface.abs().median()) <= bound_m
        assert bool((drawn.range_m[drawn.hit_mask] <= FEW_BEAMS.ranges_m[drawn.hit_mask]).all())


@few(8)
@given(exponent=st.floats(2.0, 38.5), number=NUMBERS)
def test_a_code_as_long_as_float32_holds(exponent: float, number: int) -> None:
    theta = torch.tensor([14.0, 0.0, -0.4, 0.3, 0.0, 0.0], dtype=torch.float64, requires_grad=True)
    direction = torch.randn(256, generator=torch.Generator().manual_seed(number), dtype=torch.float64)
    code = (direction / direction.norm() * 10.0**exponent).float().requires_grad_()
    drawn = render(FEW_BEAMS, DECODER.field(code), theta, SUV, preset("standard"))
    assert torch.isfinite(drawn.points).all() and math.isfinite(drawn.max_residual_m)
    # The decoder's field of this code is a whole unit everywhere.
    assert float(metric_of_suv(code.detach(), torch.tensor([[14.0, 0.0, -0.4]]).double(), theta.detach())) > 2.0
    assert (drawn.object_points, drawn.unresolved_beams) == (0, 0)


@few(12)
@given(edge=st.floats(-0.9, 0.9), theta=poses(), what=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_field_that_is_not_finite_somewhere_loses_beams_and_says_how_many(
    edge: float, theta: Tensor, what: float
) -> None:
    """Beams equal those of the finite field, or keep their returns and are counted."""
    whole = sphere(1.0)
    # Towards the sensor, so that a beam passes it before its hit; at `edge` of the object's width.
    nose = torch.nn.functional.normalize(object_from_scene(torch.zeros(1, 3).double(), theta), dim=1)[0]
    side = torch.linalg.cross(nose, torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64))

    def broken(x: Tensor) -> Tensor:
        # In sdf units of the default frame, a metre each.
        bad = (x @ nose > 0.6) & (x @ (side / side.norm()) > edge)
        return torch.where(bad, what, whole(x))

    frame = Frame(size_m=(2.0, 2.0, 2.0))
    clean, drawn = (draw(BEAMS, field, theta, EXACT, frame) for field in (whole, broken))
    assert torch.isfinite(drawn.points).all() and torch.isfinite(drawn.range_m).all()
    lost = clean.hit_mask & ~drawn.hit_mask
    assert torch.equal(drawn.points[~drawn.hit_mask], BEAMS.points[~drawn.hit_mask])
    assert int(lost.sum()) <= drawn.unresolved_beams and not bool((drawn.hit_mask & ~clean.hit_mask).any())
    both = drawn.hit_mask & clean.hit_mask
    slope = slopes(clean, BEAMS, whole, theta, frame)[both[clean.hit_mask]]
    change = (drawn.range_m - clean.range_m)[both].abs()
    assert bool((change <= 2 * known_to_m(slope, clean.range_m[both])).all())


@few(25)
@given(number=st.integers(0, 10_000), theta=poses())
def test_random_networks_have_no_hit_before_the_first_root(number: int, theta: Tensor) -> None:
    """Hits are compared with every linear piece of the network, walked from the box on without a slope bound."""
    code = torch.ones(4, dtype=torch.float64)
    field = random_decoder(number).field(code)
    # A network that is negative at the sensor has the sensor inside: such beams are rightly unresolved.
    at_sensor = ObjectField.of(field, SHAPENET_FRAME, torch.float64, 64)(object_from_scene(torch.zeros(1, 3), theta))
    assume(float(at_sensor) > 0)
    walked = draw(
        FEW_BEAMS, field, theta, preset("reference").with_(max_slope=math.inf, box_margin_m=FAST64.box_margin_m)
    )
    fast = draw(FEW_BEAMS, field, theta, EXACT)
    assert torch.isfinite(fast.points).all()
    assert fast.unresolved_beams == walked.unresolved_beams == 0
    # Short chords may be missed, but no hit is invented.
    assert not bool((fast.hit_mask & ~walked.hit_mask).any())
    both = fast.hit_mask
    slope = slopes(fast, FEW_BEAMS, field, theta)
    early = walked.range_m[both] - fast.range_m[both]
    assert bool((early <= known_to_m(slope, fast.range_m[both]) + 1e-8).all())


@few(10)
@given(level=st.floats(1e-6, 1e6), number=st.integers(0, 1000), theta=poses())
def test_a_field_that_is_positive_everywhere_changes_nothing(level: float, number: int, theta: Tensor) -> None:
    bumps = random_decoder(number).field(torch.ones(4, dtype=torch.float64))
    pose = theta.clone().requires_grad_()
    drawn = draw(BEAMS, lambda x: bumps(x).abs() + level, pose, preset("standard"))
    assert torch.equal(drawn.points, BEAMS.points) and not drawn.points.requires_grad
    assert (drawn.object_points, drawn.unresolved_beams) == (0, 0)


PIECES = st.lists(
    st.tuples(st.floats(-1.8, 1.8), st.floats(-0.7, 0.7), st.floats(-0.5, 0.5), st.floats(0.15, 0.5)),
    min_size=2,
    max_size=5,
)


@few(15)
@given(pieces=PIECES, theta=poses())
def test_a_shape_in_pieces_is_hit_at_its_nearest_piece(pieces: list[tuple[float, ...]], theta: Tensor) -> None:
    """The range of a beam e through spheres of radius r about c is the least of e c - sqrt(r^2 - d^2)."""
    field = in_frame(union(*[sphere(r, (x, y, z)) for x, y, z, r in pieces]), SHAPENET_FRAME)
    drawn = draw(BEAMS, field, theta)
    centres = scene_from_object(torch.tensor([p[:3] for p in pieces], dtype=torch.float64), theta)
    radius = torch.tensor([p[3] for p in pieces], dtype=torch.float64)
    along = BEAMS.directions @ centres.T
    off = (centres - along[..., None] * BEAMS.directions[:, None]).norm(dim=-1)
    half = (radius.square() - off.square()).clamp_min(0.0).sqrt()
    entry = torch.where(half > 0, along - half, torch.inf).amin(1)
    # A chord shorter than a step may be missed; the beam then hits the next piece, or none.
    plain = (2 * half > 1.5 * EXACT.step_m) | (half == 0)
    rows = plain.all(1)
    assert torch.equal(drawn.hit_mask[rows], torch.isfinite(entry[rows]))
    hit = rows & drawn.hit_mask
    slope = (half / radius).where(half > 0, 1.0).amin(1)
    assert bool(((drawn.range_m - entry)[hit].abs() <= 2 * known_to_m(slope, drawn.range_m)[hit]).all())
