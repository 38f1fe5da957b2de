"""The paper's experiments as sweep files, each at its full and its small size."""

from __future__ import annotations

import dataclasses

import pytest
import yaml
from by_hand import BOTH_LAMBDAS, VEHICLES, catalogue

from shift3d.cli.completion import overrides
from shift3d.errors import InputError
from shift3d.scenes.facts import SceneFacts
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.compose import compose_sweep
from shift3d.settings.expand import expand
from shift3d.settings.folders import files, shipped
from shift3d.settings.schema.config import Config
from shift3d.settings.schema.scenes import StreetConfig
from shift3d.sweep.planning.plan import make_plan
from shift3d.sweep.planning.plan_view import plan_summary

PAPERS = {
    "table_shape": (5000, 100),
    "table_pose": (2500, 100),
    "table_shape_sst": (5000, 100),
    "table_pose_sst": (2500, 100),
    "bev_transfer": (5000, 100),
    "trajectories": (500, 100),
    "hyperparameters": (1600, 600),
    "finetune": (2000, 100),
    "finetune_held_out": (500, 100),
}
"""Number of tasks at full and at small size."""


def counted(config: Config) -> Catalogue:
    """Return a catalogue with as many scenes as the settings request."""
    assert isinstance(config.scenes, StreetConfig)
    names = [f"street-{number:03}" for number in range(config.scenes.count)]
    scenes = tuple(SceneEntry(name, "street-hdl64", name, SceneFacts(name)) for name in names)
    return dataclasses.replace(catalogue(config), scenes=scenes)


@pytest.mark.parametrize("name", PAPERS)
def test_small_is_at_least_twenty_scenes_by_five_vehicles(name: str) -> None:
    plan = make_plan(compose_sweep(name, ["size=small"]), counted)[0]
    assert len(plan.tasks) == PAPERS[name][1]
    pairs = {(task.spec.vehicle, task.spec.scene) for task in plan.tasks}
    assert len(pairs) == 20 * 5 and {vehicle for vehicle, _ in pairs} == set(VEHICLES)
    assert f"sweep {name}, its small size: {len(plan.tasks)} tasks" in plan_summary(plan)


@pytest.mark.parametrize("name", PAPERS)
def test_full_is_what_the_file_states(name: str) -> None:
    configs = list(expand(compose_sweep(name)))
    assert {config.size for config in configs} == {"full"} and {config.attack.steps for config in configs} == {40}
    assert isinstance(configs[0].scenes, StreetConfig)
    shape = [config for config in configs if config.mode == "shape"]
    # A pose attack has no lambda: it occurs once for every lambda in this list, and once in the plan.
    poses = {(config.vehicle.name, config.attack.alpha) for config in configs if config.mode == "pose"}
    assert (len(shape) + len(poses)) * configs[0].scenes.count == PAPERS[name][0]


@pytest.mark.parametrize("name", PAPERS)
def test_every_file_names_its_source_in_the_paper(name: str) -> None:
    first = (shipped("sweeps") / f"{name}.yaml").read_text().splitlines()[0]
    assert first.startswith("# Source: ")


def test_the_size_itself_changes_no_task() -> None:
    small = yaml.safe_load((shipped("sweeps") / "table_shape.yaml").read_text())["small"]
    by_hand = make_plan(compose_sweep("table_shape", [f"{key}={value}" for key, value in small.items()]), counted)[0]
    named = make_plan(compose_sweep("table_shape", ["size=small"]), counted)[0]
    assert [task.spec.task_id for task in named.tasks] == [task.spec.task_id for task in by_hand.tasks]
    assert named.spec_hash == by_hand.spec_hash
    assert (named.settings["size"], by_hand.settings["size"]) == ("small", "full")


def test_what_is_given_comes_after_what_small_stands_for() -> None:
    for words in (["size=small", "scenes.count=3"], ["scenes.count=3", "size=small"]):
        configs = list(expand(compose_sweep("table_shape", [*words, "vehicle=suv", "attack.lambda=1,10"])))
        assert [config.attack.lambda_ for config in configs] == [1, 10]
        assert all(isinstance(c.scenes, StreetConfig) and c.scenes.count == 3 for c in configs)
        assert {config.attack.noise_replicates for config in configs} == {2}


def test_the_small_size_attacks_the_detector_as_published() -> None:
    for name in ("table_shape_sst", "table_pose_sst"):
        sst = next(expand(compose_sweep(name, ["size=small", "vehicle=suv"])))
        assert (sst.detector.name, sst.detector.scored_by) == ("sst", ["pointpillars"])
    reduced = next(expand(compose_sweep("table_pose_sst", ["size=small", "vehicle=suv", "detector=sst_small"])))
    assert reduced.detector.name == "sst_small"


def test_wrong_sizes_are_refused_in_one_line() -> None:
    with pytest.raises(InputError, match=r"unknown size 'tiny'\. One of: full, small"):
        compose_sweep("table_shape", ["size=tiny"])
    with pytest.raises(InputError, match=r"smoke: it has no small size\. Cut it by hand"):
        compose_sweep("smoke", ["size=small"])
    with pytest.raises(InputError, match=r"size cannot be an axis"):
        compose_sweep("table_shape", ["size=full,small"])


def test_completion_offers_the_sizes() -> None:
    assert overrides("size") == ["size="] and overrides("size=") == ["size=full", "size=small"]


def test_every_sweep_can_be_composed() -> None:
    assert set(PAPERS) < set(files("sweeps"))


@pytest.mark.parametrize(
    ("name", "words", "spec_hash"),
    [
        ("default", BOTH_LAMBDAS, "d2f6fcc38f10e977"),
        ("smoke", (), "a0e6b7a81b3968d0"),
        ("stability", (), "36af07c182667b70"),
    ],
)
def test_tasks_of_sweeps_that_were_run_keep_their_ids(name: str, words: tuple[str, ...], spec_hash: str) -> None:
    """Pinned before sizes and transfers were added: finished and half-finished folders must be found.

    The constraints of those sweeps used points alone (attack.below_ground_m=0).
    """
    earlier = compose_sweep(name, (*words, "attack.below_ground_m=0"))
    assert make_plan(earlier, catalogue)[0].spec_hash == spec_hash
