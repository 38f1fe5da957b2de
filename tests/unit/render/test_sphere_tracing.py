"""Bracketing: what must not be missed, and what counts as a miss."""

import pytest
import torch
from analytic_fields import Frame, box, sphere, union
from shift3d.render.bracket import Brackets, first_brackets
from torch import Tensor

from shift3d.render.culling import Rays
from shift3d.render.object_field import ObjectField
from shift3d.render.settings import REFERENCE, STANDARD

FLOAT64 = STANDARD.with_(dtype=torch.float64)


def along_x(offsets: Tensor, start: float = -5.0, length: float = 10.0) -> Rays:
    """Rays in +x at lateral offsets (M,) in y."""
    n = len(offsets)
    origins = torch.stack((torch.full((n,), start).double(), offsets.double(), torch.zeros(n).double()), 1)
    directions = torch.tensor([1.0, 0.0, 0.0]).double().expand(n, 3)
    return Rays(torch.arange(n), origins, directions, torch.zeros(n).double(), torch.full((n,), length).double())


def march(metric, offsets: Tensor, settings=FLOAT64, **kwargs) -> Brackets:  # type: ignore[no-untyped-def]
    field = ObjectField.of(metric, Frame(), torch.float64, 4096)
    return first_brackets(along_x(offsets, **kwargs), field, settings)


def test_brackets_hold_the_first_of_several_surfaces() -> None:
    brackets = march(union(sphere(0.5), sphere(0.3, (2.0, 0, 0))), torch.zeros(1))
    assert brackets.found.all()
    assert float(brackets.outer) - 5.0 <= -0.5 <= float(brackets.inner) - 5.0
    assert float(brackets.g_outer) >= 0 > float(brackets.g_inner)


@pytest.mark.parametrize("thickness_m", [0.02, 0.03, 0.05])
def test_plates_of_two_centimetres_are_not_missed(thickness_m: float) -> None:
    # A plate square to the beam, at 400 different phases of the march.
    positions = torch.linspace(-1.0, 1.0, 401)
    for x in positions[:: 401 // 40].tolist():
        brackets = march(box((thickness_m / 2, 3.0, 1.0), (x, 0.0, 0.0)), torch.linspace(-1, 1, 11))
        assert brackets.found.all(), x


def test_short_chords_through_a_sphere_are_mostly_found() -> None:
    # Chord lengths uniform in 0..2 cm at the sphere's limb: only the dip test can find them.
    chord = torch.linspace(0.0005, 0.02, 200).double()
    offsets = (1.0 - (chord / 2) ** 2).sqrt()
    found = march(sphere(1.0), offsets).found.double().mean()
    assert found > 0.8
    assert march(sphere(1.0), offsets, REFERENCE).found.double().mean() > 0.9


def test_a_short_chord_is_bracketed_where_it_begins() -> None:
    # A dip that is found between two samples: the crossing wanted is the way in, not the way out.
    chord = torch.linspace(0.002, 0.02, 200).double()
    offsets = (1.0 - (chord / 2) ** 2).sqrt()
    brackets = march(sphere(1.0), offsets)
    found = brackets.found
    entry, leave = 5.0 - chord / 2, 5.0 + chord / 2
    assert (brackets.outer <= entry + 1e-12)[found].all()
    assert ((brackets.inner > entry) & (brackets.inner < leave))[found].all()


def test_a_beam_that_skims_a_panel_before_it_enters_it_hits_the_first_bump() -> None:
    # Two bumps, 0.2 mm and 5 mm high, 1 cm apart on a plate along the beam: less than a step between them.
    def bumps(x: Tensor) -> Tensor:
        first = 0.0002 * torch.exp(-((x[:, 0] / 0.003) ** 2))
        second = 0.005 * torch.exp(-(((x[:, 0] - 0.012) / 0.003) ** 2))
        return x[:, 1] - first - second

    offsets = torch.full((40,), 1e-4, dtype=torch.float64)
    starts = torch.linspace(-0.6, -0.5, 40, dtype=torch.float64)
    field = ObjectField.of(bumps, Frame(), torch.float64, 4096)
    rays = along_x(offsets)
    rays = Rays(
        rays.index, rays.origins + (starts + 5.0)[:, None] * rays.directions, rays.directions, rays.near_m, rays.far_m
    )
    brackets = first_brackets(rays, field, FLOAT64)
    entry = -0.003 * float(torch.log(torch.tensor(2.0)).sqrt()) - starts
    # Both chords together are shorter than a step: most are found, and most of these at the first bump.
    found = brackets.found
    assert found.double().mean() > 0.7
    assert ((brackets.outer <= entry + 1e-9) & (brackets.inner > entry))[found].double().mean() > 0.6


def test_a_tangent_ray_is_a_miss() -> None:
    brackets = march(sphere(1.0), torch.tensor([1.0, 1.0 + 1e-9]))
    assert not brackets.found.any() and not brackets.undecided.any()


def test_g_exactly_zero_is_outside() -> None:
    # Distance in steps of exactly a quarter: samples fall on the surface itself.
    settings = FLOAT64.with_(step_m=0.25, max_step_m=0.25)
    touching = march(lambda x: x[:, 0].abs(), torch.zeros(64), settings)
    assert not touching.found.any()
    entering = march(lambda x: -x[:, 0], torch.zeros(64), settings)
    assert entering.found.all() and (entering.g_outer == 0.0).all()


def test_sensor_inside_is_undecided() -> None:
    brackets = march(sphere(1.0), torch.zeros(1), start=0.0)
    assert brackets.undecided.all() and not brackets.found.any()


def test_entry_already_inside_steps_back_towards_the_sensor() -> None:
    rays = along_x(torch.zeros(1))
    late = Rays(rays.index, rays.origins, rays.directions, rays.near_m + 4.5, rays.far_m)
    field = ObjectField.of(sphere(1.0), Frame(), torch.float64, 4096)
    brackets = first_brackets(late, field, FLOAT64)
    assert brackets.found.all()
    assert float(brackets.outer) <= 4.0 <= float(brackets.inner)


def test_a_field_of_nan_is_undecided_not_a_hit() -> None:
    brackets = march(lambda x: x[:, 0] * torch.nan, torch.zeros(3))
    assert brackets.undecided.all() and not brackets.found.any()


def test_a_field_that_is_positive_everywhere_ends_without_hits() -> None:
    brackets = march(lambda x: torch.full_like(x[:, 0], 0.1), torch.linspace(-1, 1, 5))
    assert not brackets.found.any() and not brackets.undecided.any()


def test_a_field_steeper_than_a_distance_is_not_jumped_through() -> None:
    steep = march(lambda x: 3.0 * (x.norm(dim=-1) - 0.2), torch.linspace(-0.15, 0.15, 31))
    assert steep.found.all()


def test_the_return_itself_is_sampled() -> None:
    # The beam ends 1 mm inside the surface.
    brackets = march(box((1.0, 1.0, 1.0)), torch.zeros(1), length=4.001)
    assert brackets.found.all()


@pytest.mark.parametrize("copies", [1, 7, 31, 33, 200])
def test_few_rays_find_what_many_find(copies: int) -> None:
    # The last rays of a march are looked at ahead of time: their brackets hold the same surfaces.
    scene = union(sphere(0.5), box((0.015, 0.6, 0.5), (-0.8, 0.0, 0.0)), sphere(0.3, (2.0, 0.4, 0.0)))
    offsets = torch.linspace(-0.9, 0.9, 41).double()
    many = march(scene, offsets.repeat(20))
    for offset, found, outer, inner in zip(offsets, many.found, many.outer, many.inner):
        few = march(scene, offset.repeat(copies))
        assert few.found.all() if found else not few.found.any()
        if found:
            # Both brackets hold the first crossing.
            assert (few.outer <= inner + 1e-9).all() and (outer <= few.inner + 1e-9).all()
