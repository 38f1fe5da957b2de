"""The wide family: closed, of the stated size, within published ranges, distinct, and the same for the same seed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.vehicles.family import solid
from shift3d.vehicles.family.attributes import ATTRIBUTES
from shift3d.vehicles.family.bodies import Trailer
from shift3d.vehicles.family.published import PUBLISHED, QUANTITIES, TRAILERS, published_range
from shift3d.vehicles.family.spec import MORE_BODY_TYPES, VehicleSpec
from shift3d.vehicles.family.split import SPLIT, WIDE_BODY_TYPES
from shift3d.vehicles.family.wide import (
    CYCLE,
    WideSpec,
    build_wide_mesh,
    draw_wide,
    wide_family,
    wide_vehicle,
)

STEP_M = 0.06
ROUNDING_M = 0.005
KINDS = [*WIDE_BODY_TYPES, *(f"{ATTRIBUTES[name].carriers[0]}+{name}" for name in ATTRIBUTES)]
ONE_SIDED = ("roof_box", "ladder", "spare_wheel", "tail_bicycles", "dented", "missing_panels")


def drawn(kind: str, draw: int = 0) -> WideSpec:
    body_type, *attributes = kind.split("+")
    return draw_wide(body_type, tuple(attributes), generator("test wide", kind, draw))


def top_m(mesh: trimesh.Trimesh, x: float, y: float = 0.0) -> float:
    """Return the height above the ground of the highest surface at (x, y)."""
    origin = np.array([[x, y, 9.0]])
    hit = mesh.ray.intersects_location(origin, [[0.0, 0.0, -1.0]], multiple_hits=False)[0]
    return float(hit[0, 2] - mesh.bounds[0, 2]) if len(hit) else 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_one_closed_body_of_the_stated_size(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = drawn(kind)
    unscaled: list[np.ndarray] = []
    meshed = solid._meshed
    monkeypatch.setattr(
        solid, "_meshed", lambda *given: (mesh := meshed(*given), unscaled.append(mesh.extents.copy()))[0]
    )
    mesh = build_wide_mesh(spec, STEP_M)
    assert mesh.is_watertight and mesh.body_count == 1 and mesh.volume > 0.0
    assert mesh.extents == pytest.approx(spec.size_m, abs=1e-6)
    assert mesh.bounds.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-6)
    # The stated size is that of the parts, and scaling only removes the grid's rounding.
    assert np.abs(unscaled[0] - spec.size_m).max() < STEP_M
    assert spec.kind == kind


def test_simplified_mesh_stays_closed_and_near() -> None:
    fine, simple = build_wide_mesh(drawn("suv"), 0.04), build_wide_mesh(drawn("suv"), 0.04, faces=6000)
    assert simple.is_watertight
    assert len(simple.faces) <= 6100
    assert simple.volume == pytest.approx(fine.volume, rel=0.01)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.endswith(ONE_SIDED)])
def test_what_has_no_sides_of_its_own_is_mirror_symmetric(kind: str) -> None:
    mesh = build_wide_mesh(drawn(kind), 0.08)
    assert mesh.nearest.vertex(mesh.vertices * [1, -1, 1])[0].max() < 1e-4


@pytest.mark.parametrize("body_type", [name for name in WIDE_BODY_TYPES if name != "trailer"])
def test_sizes_lie_within_published_ones(body_type: str) -> None:
    boxed = body_type in ("box_van", "camper")
    for draw in range(60):
        spec = drawn(body_type, draw)
        car = spec.chassis
        assert isinstance(car, VehicleSpec)
        length, width, height = spec.size_m
        stated = {"length_m": length, "width_m": width, "height_m": height, "wheelbase_m": car.wheelbase_m}
        stated |= {"clearance_m": car.clearance_m, "tyre_diameter_m": 2.0 * car.wheel_radius_m}
        for quantity in QUANTITIES:
            low, high = published_range(body_type, quantity)
            assert low - ROUNDING_M <= stated[quantity] <= high + ROUNDING_M, f"{body_type}: {quantity}"
        axles = (0.0, car.front_axle_s_m, car.front_axle_s_m + car.wheelbase_m, car.length_m)
        assert min(np.diff(axles)) > car.wheel_radius_m
        assert boxed == (car.height_m < height - 0.3)


def test_trailers_lie_within_published_sizes_and_have_no_cab() -> None:
    sizes = np.array([row[1:] for row in TRAILERS], np.float64)
    for draw in range(40):
        spec = drawn("trailer", draw)
        assert isinstance(spec.chassis, Trailer)
        assert (spec.size_m >= sizes.min(axis=0) - 1e-9).all() and (spec.size_m <= sizes.max(axis=0) + 1e-9).all()
    mesh = build_wide_mesh(drawn("trailer"), STEP_M)
    assert top_m(mesh, mesh.bounds[1, 0] - 0.6) < 1.2 < top_m(mesh, mesh.bounds[0, 0] + 0.5)


def test_clearance_is_the_stated_one() -> None:
    """Beams shot up between the wheels meet the floor at the height that the spec states."""
    for kind in ("sedan", "pickup+lifted", "kei_car", "limousine", "high_roof_van"):
        spec = drawn(kind)
        car = spec.chassis
        assert isinstance(car, VehicleSpec)
        mesh = build_wide_mesh(spec, 0.03)
        x = car.length_m / 2 - car.front_axle_s_m - car.wheelbase_m / 2
        hit = mesh.ray.intersects_location([[x, 0.0, -5.0]], [[0.0, 0.0, 1.0]], multiple_hits=False)[0]
        assert hit[0, 2] - mesh.bounds[0, 2] == pytest.approx(car.clearance_m, abs=0.012)


def test_attributes_are_where_they_belong() -> None:
    """Each attribute changes the surface of the vehicle at its own place."""

    def pair(kind: str) -> tuple[WideSpec, WideSpec, trimesh.Trimesh, trimesh.Trimesh]:
        having = drawn(kind)
        plain = dataclasses.replace(having, parts=(), attributes=())
        return having, plain, build_wide_mesh(having, STEP_M), build_wide_mesh(plain, STEP_M)

    having, plain, _, _ = pair("suv+roof_box")
    assert 0.3 < having.size_m[2] - plain.size_m[2] < 0.6 and having.size_m[:2] == plain.size_m[:2]
    having, plain, _, _ = pair("sedan+tail_bicycles")
    assert 0.3 < having.size_m[0] - plain.size_m[0] < 1.1
    having, plain, _, _ = pair("suv+spare_wheel")
    assert 0.19 < having.size_m[0] - plain.size_m[0] < 0.27
    having, plain, opened, closed = pair("hatchback+open_tailgate")
    car = having.chassis
    assert isinstance(car, VehicleSpec) and having.size_m[0] > plain.size_m[0]
    # From behind at the height of the deck: into the luggage space, and onto the closed gate.
    height = car.deck_z_m - 0.1
    depths = []
    for mesh in (opened, closed):
        origin = [[-9.0, 0.0, mesh.bounds[0, 2] + height]]
        hit = mesh.ray.intersects_location(origin, [[1.0, 0.0, 0.0]], multiple_hits=False)[0]
        depths.append(hit[0, 0] - mesh.bounds[1, 0])
    assert depths[0] - depths[1] > 0.5
    lifted, car = drawn("pickup+lifted"), drawn("pickup+lifted").chassis
    assert isinstance(car, VehicleSpec) and car.clearance_m > published_range("pickup", "clearance_m")[0] + 0.17
    assert lifted.parts == ()
    for kind in ("sedan+dented", "sedan+missing_panels"):
        having, plain, less, whole = pair(kind)
        assert having.size_m == plain.size_m and less.volume < 0.995 * whole.volume


def test_held_out_bodies_differ_where_they_should() -> None:
    for kind, cab_share in (("box_van", 0.8), ("camper", 0.8)):
        mesh = build_wide_mesh(drawn(kind), STEP_M)
        length, _, height = mesh.extents
        assert top_m(mesh, -0.2 * length) > 0.97 * height and top_m(mesh, 0.46 * length) < 0.5 * height
        # Over the windscreen a camper has its alcove, a box van its cab alone.
        spec = drawn(kind)
        assert isinstance(spec.chassis, VehicleSpec)
        x = length / 2 - spec.chassis.roof_front_s_m - 0.1
        assert (top_m(mesh, x) > cab_share * height) == (kind == "camper")
    assert drawn("limousine").size_m[0] > 6.1 and drawn("kei_car").size_m[1] < 1.49
    assert drawn("high_roof_van").size_m[2] > 2.45


def test_vehicles_are_distinct_and_depend_on_seed_side_and_index_alone() -> None:
    specs = wide_family(2000, seed=3)
    assert len({repr(dataclasses.astuple(spec)) for spec in specs}) == 2000
    assert specs[1234] == wide_vehicle(1234, 3) != wide_vehicle(1234, 4)
    assert specs[:20] == wide_family(20, 3)
    assert wide_vehicle(0, 3, "held_out") != wide_vehicle(0, 3)
    first, again = (build_wide_mesh(wide_vehicle(7, 3, "held_out"), 0.08) for _ in range(2))
    assert first.vertices.tobytes() == again.vertices.tobytes() and first.faces.tobytes() == again.faces.tobytes()


def test_seen_vehicles_are_seen_and_held_out_ones_are_not() -> None:
    seen = {spec.kind for spec in wide_family(600, 1)}
    held_out = [spec.kind for spec in wide_family(240, 1, "held_out")]
    assert all(set(kind.split("+")) <= set(SPLIT.seen) for kind in seen)
    assert not any(set(kind.split("+")) <= set(SPLIT.seen) for kind in held_out)
    names = {name for kind in seen for name in kind.split("+")}
    assert names == set(SPLIT.seen) and set(CYCLE) == set(SPLIT.types("seen"))
    # Every held-out name as often as any other, and one unseen name per vehicle.
    unseen = [[name for name in kind.split("+") if name in SPLIT.held_out] for kind in held_out]
    assert all(len(names) == 1 for names in unseen)
    counts = {name: sum(names == [name] for names in unseen) for name in SPLIT.held_out}
    assert set(counts.values()) == {20}


def test_the_split_holds_out_what_attacks_draw_on() -> None:
    wanted = ("roof_box", "tail_bicycles", "open_tailgate", "lifted", "box_van", "high_roof_van", "kei_car")
    wanted += ("limousine", "trailer", "camper", "dented", "missing_panels")
    assert set(wanted) == set(SPLIT.held_out)
    assert not set(SPLIT.seen) & set(SPLIT.held_out)
    assert {*SPLIT.seen, *SPLIT.held_out} == {*WIDE_BODY_TYPES, *ATTRIBUTES}


def test_what_cannot_be_drawn_says_why() -> None:
    rng = generator("x")
    for body_type, attributes, what in (
        ("tank", (), "unknown body type"),
        ("sedan", ("wings",), "unknown attribute"),
        ("convertible", ("roof_box",), "has no roof_box"),
        ("suv", ("roof_box", "roof_rails"), "at one place"),
    ):
        with pytest.raises(InputError, match=what):
            draw_wide(body_type, attributes, rng)
    with pytest.raises(InputError, match="unknown side"):
        wide_vehicle(0, 0, "test")  # type: ignore[arg-type]


def test_published_models_of_more_body_types_can_be_vehicles() -> None:
    for body_type in MORE_BODY_TYPES:
        models = PUBLISHED[body_type]
        assert len({model.name for model in models}) == len(models) >= 6, body_type
        for model in models:
            assert 0.5 * model.length_m < model.wheelbase_m < 0.8 * model.length_m
            assert 1.4 < model.width_m < 2.4 and 1.4 < model.height_m < 3.4
            assert model.clearance_m is None or 0.1 < model.clearance_m < 0.3
