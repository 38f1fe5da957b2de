"""Naturalness against small sets: nearest members, verdicts, and changes that must not affect them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from torch import Tensor
from vehicles_by_hand import Meshes, legged, legged_boxes, measures, on_legs, reference

from shift3d.errors import InputError
from shift3d.naturalness.decoded import decoded_mesh
from shift3d.naturalness.measure import NO_SURFACE_MEASURE, NaturalnessMeter, largest_piece
from shift3d.naturalness.reference import nearest_by_fingerprint
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.vehicles.family.wide import build_wide_mesh, wide_vehicle
from shift3d.vehicles.vehicle import Vehicle

LENGTHS = np.round(np.linspace(3.6, 5.6, 21), 2)
SCALE_M = 3.0
VEHICLE = Vehicle("legs", np.zeros(4, np.float32), SCALE_M, np.eye(3), np.zeros(3), (4.5, 1.8, 1.3))


@pytest.fixture(scope="module")
def set_of_20() -> NaturalnessMeter:
    return measures(legged(LENGTHS))


@pytest.fixture(scope="module")
def vehicles() -> list[trimesh.Trimesh]:
    return [build_wide_mesh(wide_vehicle(index, 3), 0.1) for index in range(40)]


class Boxes:
    """Decoder that returns boxes, (centre, size) each in metres, for any code; without boxes: no surface at all."""

    def __init__(self, boxes: list[tuple[tuple[float, float, float], tuple[float, float, float]]]) -> None:
        self.boxes = boxes

    def field(self, code: Tensor) -> Callable[[Tensor], Tensor]:
        def distance(points: Tensor) -> Tensor:
            found = [torch.full((len(points),), 1.0 + float(code.sum()))]
            for centre, size in self.boxes:
                beyond = (points * SCALE_M - torch.tensor(centre)).abs() - torch.tensor(size) / 2
                found.append(beyond.clamp(min=0).norm(dim=-1) + beyond.amax(-1).clamp(max=0))
            return torch.stack(found).amin(0) / SCALE_M

        return distance


def test_a_member_is_its_own_nearest_at_distance_zero(set_of_20: NaturalnessMeter) -> None:
    found = set_of_20.of(on_legs(length_m=4.6))
    assert found.nearest is not None and found.nearest.name == "member-10"
    assert found.nearest.mean_cm < 0.05 and found.nearest.p95_cm < 0.1
    assert found.percentile == 0.0 and found.natural


def test_a_shape_between_two_members_is_as_far_as_its_ends_are(set_of_20: NaturalnessMeter) -> None:
    """A shape 3 cm longer than a member is off by 1.5 cm at both ends, which are 2 x 1.8 x 1.1 m of the area."""
    found = set_of_20.of(on_legs(length_m=4.63))
    assert found.nearest is not None and found.nearest.name == "member-10"
    ends = 2 * 1.8 * 1.1 / on_legs().area
    assert found.nearest.mean_cm == pytest.approx(1.5 * ends, abs=0.12)
    assert found.natural, "members are 10 cm from each other"


def test_a_member_left_out_lies_at_the_median(set_of_20: NaturalnessMeter) -> None:
    """Members at equal steps all have the same distance: none has less than the least."""
    left_out = set_of_20.reference.calibration
    assert left_out.mean_cm.std() < 0.15 * left_out.mean_cm.mean()
    assert measures(legged([*np.delete(LENGTHS, 10).tolist(), 3.5])).of(on_legs(length_m=4.6)).natural


def test_far_from_all_members_is_the_hundredth_percentile(set_of_20: NaturalnessMeter) -> None:
    fin = trimesh.creation.box((2.5, 0.1, 0.4), trimesh.transformations.translation_matrix((0, 0, 1.5)))
    found = set_of_20.of(trimesh.util.concatenate([on_legs(length_m=4.6), fin]))
    assert found.percentile == 100.0 and not found.natural and found.out_of_range == ()
    assert found.nearest is not None and found.nearest.to_member_cm[0] > 2 * found.nearest.from_member_cm[0]
    lost = set_of_20.of(trimesh.creation.box((4.6, 1.8, 1.1), trimesh.transformations.translation_matrix((0, 0, 1))))
    assert lost.nearest is not None and lost.nearest.from_member_cm[0] > lost.nearest.to_member_cm[0]


def test_sizes_that_no_vehicle_has_are_unnatural_even_for_a_member() -> None:
    """A reference set that is half squeezed vehicles makes none of them natural: metres count, not shape alone."""
    squeezed = []
    for length in LENGTHS[:9]:
        mesh = on_legs(length_m=float(length))
        mesh.apply_scale((1.0, 0.5, 1.0))
        squeezed.append(mesh)
    found = measures(Meshes((*legged(LENGTHS).meshes, *squeezed))).of(squeezed[3])
    assert found.percentile == 0.0 and found.out_of_range == ("width_m",) and not found.natural
    assert not found.within(100.0)


def test_a_mirrored_asymmetric_vehicle_is_another_one(set_of_20: NaturalnessMeter) -> None:
    block = trimesh.creation.box((1.0, 0.3, 0.3), trimesh.transformations.translation_matrix((0.5, 0.7, 1.45)))
    left = trimesh.util.concatenate([on_legs(), block])
    right = left.copy()
    right.apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    found = measures(Meshes((*legged(LENGTHS).meshes, left)))
    same, other = found.of(left), found.of(right)
    assert same.nearest is not None and other.nearest is not None
    assert same.nearest.mean_cm < 0.05 < 0.3 < other.nearest.mean_cm
    fixed, mirrored = set_of_20.of(left), set_of_20.of(right)
    assert fixed.nearest is not None and mirrored.nearest is not None
    assert fixed.nearest.mean_cm == pytest.approx(mirrored.nearest.mean_cm, abs=0.1), "of symmetric members"


def test_the_order_of_members_changes_names_alone(vehicles: list[trimesh.Trimesh]) -> None:
    order = np.random.default_rng(0).permutation(22)
    one = measures(Meshes(tuple(vehicles[:22])))
    other = measures(Meshes(tuple(vehicles[index] for index in order)))
    for shape in vehicles[22:25]:
        a, b = one.of(shape), other.of(shape)
        assert a.nearest is not None and b.nearest is not None
        assert (a.nearest.to_member_cm, a.nearest.from_member_cm) == (b.nearest.to_member_cm, b.nearest.from_member_cm)
        assert (a.percentile, a.sizes, a.natural) == (b.percentile, b.sizes, b.natural)
        assert order[b.nearest.index] == a.nearest.index


def test_the_prefilter_finds_the_member_that_brute_force_finds(vehicles: list[trimesh.Trimesh]) -> None:
    found = reference(Meshes(tuple(vehicles)))
    for number in range(0, len(vehicles), 6):
        shape = found.surface(number)
        exact = found.nearest(shape, left_out=number, candidates=len(found))
        assert found.nearest(shape, left_out=number).mean_cm <= exact.mean_cm + 0.01
        own = found.fingerprints[number]
        assert number not in nearest_by_fingerprint(own, found.fingerprints, len(found), number)
        assert nearest_by_fingerprint(own, found.fingerprints, 1)[0] == number


def test_the_same_shape_gives_the_same_numbers(set_of_20: NaturalnessMeter, vehicles: list[trimesh.Trimesh]) -> None:
    assert measures(legged(LENGTHS)).of(vehicles[30]) == set_of_20.of(vehicles[30].copy())


def test_a_code_is_measured_by_what_it_decodes_to(set_of_20: NaturalnessMeter) -> None:
    decoder: Any = Boxes(legged_boxes(length_m=4.6))
    found = set_of_20.of_code(VEHICLE, decoder, np.zeros(4, np.float32))
    assert found.nearest is not None and found.nearest.name == "member-10" and found.nearest.mean_cm < 1.0
    assert found.sizes is not None and found.sizes.length_m == pytest.approx(4.6, abs=0.03)
    assert found.largest_piece == pytest.approx(1.0)


def test_the_quick_surface_is_the_thorough_one_to_a_centimetre() -> None:
    from shift3d.vehicles.sources import VehicleSet
    from shift3d.vehicles.vehicle import vehicle_mesh

    source = VehicleSet()
    suv, decoder = source.vehicle("suv"), source.decoder()
    quick = surface_of_mesh(decoded_mesh(suv, decoder, suv.latent_code))
    thorough = surface_of_mesh(vehicle_mesh(suv, decoder, resolution=97))
    assert quick.distances_to(thorough.points).mean() < 0.01 and thorough.distances_to(quick.points).mean() < 0.01
    assert quick.size_m == pytest.approx(thorough.size_m, abs=0.01)


def test_a_code_without_a_surface_is_unnatural(set_of_20: NaturalnessMeter) -> None:
    decoder: Any = Boxes([])
    found = set_of_20.of_code(VEHICLE, decoder, np.zeros(4, np.float32))
    assert found == NO_SURFACE_MEASURE and found.percentile == 100.0 and not found.natural and not found.within(100.0)
    broken: Any = Boxes(legged_boxes())
    assert set_of_20.of_code(VEHICLE, broken, np.full(4, np.nan, np.float32)) == NO_SURFACE_MEASURE, "NaN is no surface"
    with pytest.raises(InputError, match="of the same decoder"):
        set_of_20.of_code(VEHICLE, broken, np.zeros(5, np.float32))


@pytest.mark.parametrize(
    ("side", "above_m", "natural"),
    [(0.5, 0.3, True), (0.9, 0.3, False), (0.9, 0.1, True)],
    ids=["a small part", "a large part", "a part on bars thinner than the grid"],
)
def test_a_shape_with_more_than_a_tenth_of_its_surface_loose_is_no_vehicle(
    set_of_20: NaturalnessMeter, side: float, above_m: float, natural: bool
) -> None:
    """A cube that floats over a member is no vehicle at any percentile."""
    loose = (0.0, 0.0, 1.3 + above_m + side / 2), (side, side, side)
    decoder: Any = Boxes([*legged_boxes(length_m=4.6), loose])
    found = set_of_20.of_code(VEHICLE, decoder, np.zeros(4, np.float32))
    body = on_legs(length_m=4.6).area - 4 * 2 * (0.5 * 0.2 + 0.5 * 0.3 + 0.2 * 0.3)  # area that legs hide, both sides
    together = body / (body + 6 * side**2) if above_m > 0.2 else 1.0
    assert found.largest_piece == pytest.approx(together, abs=0.02)
    assert found.within(100.0) == natural and found.out_of_range == (() if natural else ("largest_piece",))


def test_pieces_of_a_mesh_may_touch_without_sharing_corners(set_of_20: NaturalnessMeter) -> None:
    assert set_of_20.of(on_legs()).largest_piece is None
    body, beside = trimesh.creation.box((2.0, 1.0, 1.0)), trimesh.creation.box((1.0, 1.0, 1.0))
    for apart_m, together in ((0.1, 1.0), (0.3, 10 / 16)):
        both = [body, beside.copy().apply_translation((1.5 + apart_m, 0.0, 0.0))]
        assert largest_piece(trimesh.util.concatenate(both)) == pytest.approx(together)


def test_what_stands_on_bars_thinner_than_the_grid_hangs_together() -> None:
    from shift3d.vehicles.sources import VehicleSet

    source = VehicleSet("wide")
    decoder, on_bars = source.decoder(), [name for name in source.names() if "roof_box" in name or "ladder" in name]
    assert on_bars
    for name in on_bars:
        vehicle = source.vehicle(name)
        assert largest_piece(decoded_mesh(vehicle, decoder, vehicle.latent_code)) > 0.95, name
