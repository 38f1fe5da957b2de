"""Tasks whose vehicle has parameters: a search over kinds, and a requested edit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from short_tasks import THERE, by_method, make_spec, with_vehicles

from shift3d.attack.shape import SNAP_M, on_ground
from shift3d.errors import InputError
from shift3d.placement.sampling import Placement
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.sweep.planning.plan import make_plan
from shift3d.task.assets import Assets
from shift3d.task.follow_ups.rendered import render_solution
from shift3d.task.problem import build_problem, place_vehicle, with_other_vehicle
from shift3d.task.run import run_task
from shift3d.task.scoring import score_object
from shift3d.task.spec import AttackSpec, TransferScene


@pytest.fixture(scope="module")
def wide(assets: Assets) -> Assets:
    return with_vehicles(assets, "wide")


def test_a_search_over_kinds_says_as_which_vehicle_its_shape_is_drawn(wide: Assets) -> None:
    attack = AttackSpec(steps=1, random_replicates=0, noise_replicates=1, search="random", space="family")
    spec = make_spec(vehicle="sedan", lambda_=0.0, attack=attack)
    found = run_task(spec, wide)
    drawn_as = {row["method"]: row["drawn_as"] for row in found.solutions}
    assert drawn_as["baseline"] is None
    assert drawn_as["adversarial"] == drawn_as["adversarial_noise"] != "sedan"
    vehicle = wide.vehicles.vehicle(drawn_as["adversarial"])
    (solution,) = (row for row in found.solutions if row["method"] == "adversarial")
    (scored,) = by_method(found, "adversarial")
    again = render_solution(spec, solution, wide)
    assert again.problem.size_m.tolist() == list(vehicle.size_m)
    assert again.rendering.object_points == scored["object_points"]
    # On the ground at the baseline's place.
    (baseline,) = by_method(found, "baseline")
    bottoms = [row["z_m"] - height / 2 for row, height in ((scored, vehicle.size_m[2]), (baseline, 1.45))]
    assert bottoms[0] == pytest.approx(bottoms[1], abs=0.1)
    assert all(scored[name] == baseline[name] for name in ("x_m", "y_m", "yaw_rad"))


def test_a_universal_search_over_kinds_puts_each_kind_into_every_scene(wide: Assets) -> None:
    attack = AttackSpec(
        steps=1, random_replicates=0, noise_replicates=0, search="random", space="family", search_scenes=1
    )
    spec = make_spec(vehicle="sedan", lambda_=0.0, attack=attack, transfer_scenes=(TransferScene(THERE, ""),))
    found = run_task(spec, wide)
    (solution,) = (row for row in found.solutions if row["method"] == "adversarial")
    vehicle = wide.vehicles.vehicle(solution["drawn_as"])
    moved = spec.moved_to(spec.transfer_scenes[0])
    placement = place_vehicle(moved, wide)
    assert isinstance(placement, Placement) and vehicle.name != "sedan"
    problem = with_other_vehicle(moved, wide, build_problem(moved, wide, placement.theta), vehicle)
    code = torch.tensor(solution["latent_code"])
    there = score_object(problem, code, on_ground(code, problem, SNAP_M), 5.0).results["pointpillars"].adversarial_loss
    kept = found.trajectories[by_method(found, "adversarial")[0]["best_step"]]
    # The search rendered it partly in bfloat16, to a few thousandths.
    assert kept["loss"] == pytest.approx((kept["adversarial_loss"] + there) / 2, rel=0.02)
    assert kept["loss"] != pytest.approx(kept["adversarial_loss"], rel=0.05)


def test_a_search_that_cannot_go_over_kinds_is_refused() -> None:
    words = ["vehicle=wide", "vehicle.name=sedan", "mode=shape", "attack.space=family", "attack.search=evolution"]
    with pytest.raises(InputError, match="search evolution stays with one kind"):
        make_plan(compose_sweep("default", words), read_catalogue)


def test_a_vehicle_without_parameters_is_a_kind_of_its_own(assets: Assets) -> None:
    """The vehicle's shape moves along the principal components of the set's codes; its length is its own."""
    attack = AttackSpec(steps=1, random_replicates=0, noise_replicates=0, search="random", space="family", components=6)
    found = run_task(make_spec(vehicle="suv", lambda_=0.0, attack=attack), assets)
    (solution,) = (row for row in found.solutions if row["method"] == "adversarial")
    vehicle = assets.vehicles.vehicle(solution["drawn_as"])
    assert vehicle.name != "suv"
    codes = assets.vehicles.codes().astype(np.float64)
    axes = np.linalg.svd(codes - codes.mean(axis=0), full_matrices=False)[2][:6]
    moved = np.array(solution["latent_code"]) - vehicle.latent_code
    assert np.linalg.norm(moved) > 0.1
    assert moved - axes.T @ (axes @ moved) == pytest.approx(0.0, abs=1e-6)


def test_an_edited_vehicle_stands_where_its_baseline_does(wide: Assets) -> None:
    attack = AttackSpec(steps=0, random_replicates=0, noise_replicates=0, edit="chassis.height_m:-1")
    found = run_task(make_spec(vehicle="sedan", attack=attack), wide)
    (before,), (after,) = by_method(found, "baseline"), by_method(found, "edited")
    assert all(after[name] == before[name] for name in ("x_m", "y_m", "yaw_rad"))
    assert after["score"] != before["score"]
    codes = {row["method"]: np.array(row["latent_code"]) for row in found.solutions}
    box = wide.vehicles.parameters("sedan")
    at = box.names.index("chassis.height_m")
    moved = (box.low[at] - box.start[at]) * box.basis[at]
    assert codes["edited"] - codes["baseline"] == pytest.approx(moved, abs=1e-6)


def test_an_edit_of_an_unknown_parameter_names_those_there_are() -> None:
    words = ["vehicle=wide", "vehicle.name=sedan", "mode=shape", "attack.edit=chassis.wings_m:1"]
    with pytest.raises(InputError, match=r"no parameter 'chassis\.wings_m'.*chassis\.height_m"):
        make_plan(compose_sweep("default", words), read_catalogue)
    words[-1] = "attack.edit=chassis.height_m:2"
    with pytest.raises(InputError, match=r"'2' is no place in the range of chassis\.height_m.*from -1 to 1"):
        make_plan(compose_sweep("default", words), read_catalogue)
    with pytest.raises(InputError, match="made of no parameters"):
        make_plan(compose_sweep("default", ["mode=shape", "attack.edit=chassis.height_m:1"]), read_catalogue)
