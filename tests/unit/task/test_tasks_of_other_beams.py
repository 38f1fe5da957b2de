"""The same vehicle at the same place under the beams of another sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from short_tasks import STREET, make_spec

from shift3d.geometry.se3 import object_from_scene
from shift3d.placement.sampling import Placement
from shift3d.settings.schema.scenes import StreetConfig, scene_set
from shift3d.task.assets import Assets, load_assets
from shift3d.task.exchange import AssetsSpec
from shift3d.task.places import survey_scene
from shift3d.task.problem import build_problem, place_vehicle
from shift3d.task.spec import TaskSpec, TransferScene

NAMES = (None, "hdl32")


def seen_by(beams: str | None) -> tuple[TaskSpec, Assets]:
    street = {**STREET, "beams": beams}
    scenes = scene_set(StreetConfig(**street))  # type: ignore[arg-type]
    name = scenes.names()[0]
    spec = make_spec(scene=name, scene_hash=scenes.load(name).content_hash())
    return spec, load_assets(AssetsSpec(scenes=street, detectors={}))


@pytest.fixture(scope="module")
def placed() -> dict[str | None, tuple[TaskSpec, Assets, Placement]]:
    found = {}
    for beams in NAMES:
        spec, assets = seen_by(beams)
        placement = place_vehicle(spec, assets)
        assert isinstance(placement, Placement)
        found[beams] = (spec, assets, placement)
    return found


def test_the_pose_is_the_same_to_the_bit(placed: dict[str | None, tuple[TaskSpec, Assets, Placement]]) -> None:
    poses = {tuple(placement.theta.tolist()) for _, _, placement in placed.values()}
    assert len(poses) == 1
    assert len({spec.task_id for spec, _, _ in placed.values()}) == len(NAMES)


def test_places_are_counted_where_tasks_place(
    placed: dict[str | None, tuple[TaskSpec, Assets, Placement]],
) -> None:
    found = [
        survey_scene(assets.scenes, spec.scene, replace(spec.placement, attempts=100))
        for spec, assets, _ in placed.values()
    ]
    assert found[0].outcomes == found[1].outcomes and found[0].free.any()


def test_every_sensors_hits_lie_on_the_same_surface(
    placed: dict[str | None, tuple[TaskSpec, Assets, Placement]],
) -> None:
    counts = {}
    for beams, (spec, assets, placement) in placed.items():
        problem = build_problem(spec, assets, placement.theta)
        with torch.no_grad():
            rendering = problem.insert(problem.code0, problem.theta0)
            hits = object_from_scene(rendering.points[rendering.hit_mask].double(), problem.theta0)
            residual = problem.metric(problem.code0)(hits)
        counts[beams] = len(hits)
        assert float(residual.abs().max()) < 2e-3
    assert counts["hdl32"] < counts[None] and min(counts.values()) > 20


def test_the_ids_of_streets_seen_by_their_own_sensor_do_not_say_beams() -> None:
    from shift3d.settings.catalogue.reading import read_catalogue
    from shift3d.settings.compose import compose_sweep, validate

    own = read_catalogue(validate(compose_sweep("smoke", ["scenes.count=1"]).base, "smoke"))
    other = read_catalogue(validate(compose_sweep("smoke", ["scenes.count=1", "scenes.beams=hdl32"]).base, "smoke"))
    assert "beams" not in own.scene_arguments and other.scene_arguments["beams"] == "hdl32"
    np.testing.assert_array_equal(own.sector_rad, other.sector_rad)


def test_a_shape_is_put_into_another_scene_at_one_place_whatever_beams_see_its_own(
    placed: dict[str | None, tuple[TaskSpec, Assets, Placement]],
) -> None:
    other = TransferScene("street_another", "hash")
    seeds = {
        spec.moved_to(other, assets.placement_scene(spec)[2]).placement_seed for spec, assets, _ in placed.values()
    }
    assert len(seeds) == 1
    assert len({spec.moved_to(other).placement_seed for spec, _, _ in placed.values()}) == len(placed)
