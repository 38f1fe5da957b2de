"""Sphere tracing: surfaces that it must find, the definition of a miss, and the default solver's plain reference."""

import math
from dataclasses import replace

import pytest
import torch
from analytic_fields import Field, Frame, box, car, in_frame, rounded, sector_scan, sphere, union
from straight_rays import FLOAT64, along_x, chords, cold, field_of, is_found
from torch import Tensor

from shift3d.errors import InputError
from shift3d.render import Beams, Rendering, preset, render
from shift3d.render.culling import object_rays
from shift3d.render.settings import REFERENCE
from shift3d.render.solvers.refinement import Refinement
from shift3d.render.solvers.sphere_tracing import outside

FRAME = Frame(scale_m=2.5)
FINE = preset("standard").with_(dtype=torch.float64, tolerance_m=1e-9, final_newton_m=0.0)
PLAIN = FINE.with_(solver="plain_sphere_tracing")
THETA = torch.tensor([12.0, 1.0, -0.5, 0.4, 0.0, 0.0], dtype=torch.float64)


def march(metric: Field, offsets: Tensor, settings=FLOAT64, start: float = -5.0, length: float = 10.0) -> Refinement:  # type: ignore[no-untyped-def]
    return cold(along_x(*offsets.tolist(), start=start, length=length), metric, settings)


def drawn(beams: Beams, metric: Field, settings=PLAIN, **changes: object) -> Rendering:  # type: ignore[no-untyped-def]
    return render(beams, in_frame(metric, FRAME), THETA, FRAME, settings.with_(**changes))


@pytest.fixture(scope="module")
def beams() -> Beams:
    return Beams.from_arrays(*sector_scan((12.0, 1.0, -0.5), half_angle_rad=0.2, rays=60))


SHAPES = {
    "sphere": sphere(0.7),
    "box": box((1.2, 0.6, 0.5)),
    "car": car(),
    "union": union(sphere(0.5, (0.9, 0.2, 0.1)), rounded(box((0.3, 0.5, 0.4), (-0.8, 0.0, 0.0)), 0.05)),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_default_solver_and_its_plain_reference_agree(name: str, beams: Beams) -> None:
    plain, default = (drawn(beams, SHAPES[name], each) for each in (PLAIN, FINE))
    apart = (plain.hit_mask != default.hit_mask) | ((plain.range_m - default.range_m).abs() > 1e-5)
    assert default.object_points > 150 and int(apart.sum()) <= 0.01 * default.object_points
    # Only on chords that the plain reference may step over.
    rows = torch.nonzero(apart).squeeze(1)
    for each in chords(SHAPES[name], object_rays(beams, rows, THETA)):
        assert each == [] or each[0][1] - each[0][0] < PLAIN.step_m + 2e-3
    assert not (plain.hit_mask & ~default.hit_mask).any() and (default.range_m <= plain.range_m + 1e-5).all()


@pytest.mark.parametrize("settings", [PLAIN, FINE], ids=["plain", "default"])
def test_a_sphere_is_hit_where_it_is(settings) -> None:  # type: ignore[no-untyped-def]
    fan = Beams.from_arrays(*sector_scan((12.0, 1.0, -0.5), half_angle_rad=0.05, rays=20))
    found = drawn(fan, sphere(0.7), settings)
    along = fan.directions @ THETA[:3]
    expected = along - (0.49 - (THETA[:3].square().sum() - along**2)).clamp_min(0).sqrt()
    assert found.object_points > 100
    assert float((found.range_m - expected)[found.hit_mask].abs().max()) < 1e-7


def test_finer_steps_of_the_plain_reference_miss_less_and_cost_more(beams: Beams) -> None:
    truth = drawn(beams, car(), FINE, step_m=0.002)
    missed, evaluations = [], []
    for step_m in (0.4, 0.1, 0.025):
        found = drawn(beams, car(), step_m=step_m)
        off = truth.hit_mask & ~(found.hit_mask & ((found.range_m - truth.range_m).abs() < 0.01))
        missed.append(int(off.sum()))
        evaluations.append(found.evaluations)
    assert missed[0] > missed[1] > missed[2]
    assert evaluations[0] < evaluations[1] < evaluations[2]


@pytest.mark.parametrize("settings", [PLAIN, FINE], ids=["plain", "default"])
def test_a_sensor_inside_the_object_is_unresolved(settings) -> None:  # type: ignore[no-untyped-def]
    fan = Beams.from_arrays(*sector_scan((12.0, 0.0, 0.0), rays=5))
    inside = render(fan, in_frame(sphere(0.7), FRAME), torch.zeros(6, dtype=torch.float64), FRAME, settings)
    assert inside.unresolved_beams == 25 and inside.object_points == 0
    assert torch.equal(inside.points, fan.points)


def test_a_solver_that_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match="nonsense"):
        preset("standard").with_(solver="nonsense")


def test_brackets_hold_the_first_of_several_surfaces() -> None:
    found = march(union(sphere(0.5), sphere(0.3, (2.0, 0, 0))), torch.zeros(1))
    b = found.brackets
    assert is_found(found).all()
    assert float(b.outer) - 5.0 <= -0.5 <= float(b.inner) - 5.0
    assert float(b.g_outer) >= 0 > float(b.g_inner)


@pytest.mark.parametrize("thickness_m", [0.02, 0.03, 0.05])
def test_plates_of_two_centimetres_are_not_missed(thickness_m: float) -> None:
    # A plate perpendicular to the beam, at 400 different phases of the march.
    positions = torch.linspace(-1.0, 1.0, 401)
    for x in positions[:: 401 // 40].tolist():
        found = march(box((thickness_m / 2, 3.0, 1.0), (x, 0.0, 0.0)), torch.linspace(-1, 1, 11))
        assert is_found(found).all(), x


def test_short_chords_through_a_sphere_are_mostly_found() -> None:
    # Chord lengths uniform in 0..2 cm at the sphere's limb: only the search for local minima can find them.
    chord = torch.linspace(0.0005, 0.02, 200).double()
    offsets = (1.0 - (chord / 2) ** 2).sqrt()
    found = is_found(march(sphere(1.0), offsets)).double().mean()
    assert found > 0.8
    assert is_found(march(sphere(1.0), offsets, REFERENCE)).double().mean() > 0.9


def test_a_short_chord_is_bracketed_where_it_begins() -> None:
    # A local minimum found between two samples: the wanted crossing is the entry, not the exit.
    chord = torch.linspace(0.002, 0.02, 200).double()
    b = march(sphere(1.0), (1.0 - (chord / 2) ** 2).sqrt()).brackets
    entry, leave = (5.0 - chord / 2)[b.rows], (5.0 + chord / 2)[b.rows]
    assert (b.outer <= entry + 1e-12).all() and ((b.inner > entry) & (b.inner < leave)).all()


def test_a_beam_that_skims_a_panel_before_it_enters_it_hits_the_first_bump() -> None:
    # Two bumps, 0.2 mm and 5 mm high, 1 cm apart on a plate along the beam: less than a step between them.
    def bumps(x: Tensor) -> Tensor:
        first = 0.0002 * torch.exp(-((x[:, 0] / 0.003) ** 2))
        second = 0.005 * torch.exp(-(((x[:, 0] - 0.012) / 0.003) ** 2))
        return x[:, 1] - first - second

    offsets = torch.full((40,), 1e-4, dtype=torch.float64)
    starts = torch.linspace(-0.6, -0.5, 40, dtype=torch.float64)
    rays = along_x(*offsets.tolist(), start=0.0)
    rays = replace(rays, origins=rays.origins + starts[:, None] * rays.directions)
    found = cold(rays, bumps)
    b, entry = found.brackets, -0.003 * math.sqrt(math.log(2.0)) - starts
    # Both chords together are shorter than a step: most are found, and most of these at the first bump.
    assert len(b.rows) > 0.7 * len(rays)
    assert ((b.outer <= entry[b.rows] + 1e-9) & (b.inner > entry[b.rows])).double().mean() > 0.6


def test_a_tangent_ray_is_a_miss() -> None:
    found = march(sphere(1.0), torch.tensor([1.0, 1.0 + 1e-9]))
    assert not is_found(found).any() and not found.undecided.any()


def test_g_exactly_zero_is_outside() -> None:
    # Distance in steps of exactly a quarter: samples fall on the surface itself.
    settings = FLOAT64.with_(step_m=0.25, max_step_m=0.25)
    touching = march(lambda x: x[:, 0].abs(), torch.zeros(64), settings)
    assert not is_found(touching).any()
    entering = march(lambda x: -x[:, 0], torch.zeros(64), settings, start=0.0)
    assert is_found(entering).all() and (entering.brackets.g_outer == 0.0).all()


def test_sensor_inside_is_undecided() -> None:
    found = march(sphere(1.0), torch.zeros(1), start=0.0)
    assert found.undecided.all() and not is_found(found).any()


def test_entry_already_inside_steps_back_towards_the_sensor() -> None:
    rays = along_x(0.0, start=-5.0, length=10.0)
    late = replace(rays, near_m=rays.near_m + 4.5)
    rays, g, undecided = outside(late, field_of(sphere(1.0)))
    assert 3.8 < float(rays.near_m) <= 4.0 and float(g) >= 0 and not undecided.any()
    b = cold(late, sphere(1.0)).brackets
    assert b.rows.tolist() == [0] and float(b.outer) <= 4.0 <= float(b.inner)


def test_a_field_of_nan_is_undecided_not_a_hit() -> None:
    found = march(lambda x: x[:, 0] * torch.nan, torch.zeros(3))
    assert found.undecided.all() and not is_found(found).any()


def test_a_field_that_is_positive_everywhere_ends_without_hits() -> None:
    found = march(lambda x: torch.full_like(x[:, 0], 0.1), torch.linspace(-1, 1, 5))
    assert not is_found(found).any() and not found.undecided.any()


@pytest.mark.parametrize("rays", [31, 62])
def test_a_field_steeper_than_a_distance_is_not_jumped_through(rays: int) -> None:
    steep = march(lambda x: 3.0 * (x.norm(dim=-1) - 0.2), torch.linspace(-0.15, 0.15, rays))
    assert is_found(steep).all()


def test_the_return_itself_is_sampled() -> None:
    # The beam ends 1 mm inside the surface.
    found = march(box((1.0, 1.0, 1.0)), torch.zeros(1), length=4.001)
    assert is_found(found).all()


@pytest.mark.parametrize("copies", [1, 7, 31, 33, 200])
def test_few_rays_find_what_many_find(copies: int) -> None:
    # The last rays are not traced but refined: their brackets hold the same surfaces.
    scene = union(sphere(0.5), box((0.015, 0.6, 0.5), (-0.8, 0.0, 0.0)), sphere(0.3, (2.0, 0.4, 0.0)))
    offsets = torch.linspace(-0.9, 0.9, 41).double()
    many = march(scene, offsets.repeat(20))
    place = {row: at for at, row in enumerate(many.brackets.rows.tolist())}
    for number, offset in enumerate(offsets):
        few = march(scene, offset.repeat(copies))
        assert is_found(few).all() if number in place else not is_found(few).any()
        if number in place:
            # Both brackets hold the first crossing.
            outer, inner = (float(part[place[number]]) for part in (many.brackets.outer, many.brackets.inner))
            assert (few.brackets.outer <= inner + 1e-9).all() and (outer <= few.brackets.inner + 1e-9).all()
