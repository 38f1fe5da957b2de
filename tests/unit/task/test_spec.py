"""A task's id: everything that can change its result, and nothing else."""

from __future__ import annotations

import dataclasses
import json
from typing import Any, get_args

import pytest

from shift3d.attack.names import SearchName, SpaceName
from shift3d.task import spec as spec_module
from shift3d.task.spec import AttackSpec, PlacementSpec, TaskSpec, TransferScene, label_words

SPEC = TaskSpec("suv", "street_000", "street-hdl64", "shape", 1.0, 0.01, "pointpillars", "standard")

CHANGES: dict[str, Any] = {
    "vehicle": "coupe",
    "scene": "street_001",
    "dataset": "kitti",
    "lambda_": 10.0,
    "alpha": 0.1,
    "detector": "sst",
    "accuracy": "paper",
    "base_seed": 1,
    "replicate": 1,
    "effects": ("rain",),
    "effect_settings": {"rain_mm_h": 5.0},
    "accuracy_settings": {"step_m": 0.1},
    "scene_arguments": {"seed": 3},
    "attack": AttackSpec(steps=41),
    "placement": PlacementSpec(contact_m=0.03),
    "scene_hash": "a",
    "vehicle_hash": "a",
    "decoder_hash": "a",
    "reference_hash": "a",
    "scored_by": ("pointpillars", "sst"),
    "detector_hashes": {"pointpillars": "a"},
    "transfer_scenes": (TransferScene("street_001", "b"),),
}


def test_every_field_changes_the_id() -> None:
    fields = {field.name for field in dataclasses.fields(TaskSpec)} - {"mode"}
    assert fields == set(CHANGES)
    ids = {dataclasses.replace(SPEC, **{name: value}).task_id for name, value in CHANGES.items()}
    assert len(ids | {SPEC.task_id}) == len(CHANGES) + 1


@pytest.mark.parametrize("field", dataclasses.fields(AttackSpec), ids=lambda field: field.name)
def test_every_part_of_the_search_changes_the_id_and_comes_back(field: dataclasses.Field[Any]) -> None:
    other = "another" if isinstance(field.default, str) else field.default + 1
    changed = dataclasses.replace(SPEC, attack=dataclasses.replace(SPEC.attack, **{field.name: other}))
    assert changed.task_id != SPEC.task_id
    assert TaskSpec.from_dict(json.loads(changed.canonical_json())) == changed


def test_the_id_is_pinned() -> None:
    """A change of this value makes every finished sweep unresumable: raise SPEC_VERSION with it."""
    assert SPEC.task_id == "afa09fae1ef967efaad2268bd09b5990"


@dataclasses.dataclass(frozen=True)
class WithLoss(AttackSpec):
    loss: str = "paper"


def test_a_new_field_of_the_search_leaves_ids_alone_at_its_default() -> None:
    ids = [dataclasses.replace(SPEC, attack=attack).task_id for attack in (WithLoss(), WithLoss(loss="top_logit"))]
    assert ids[0] == SPEC.task_id != ids[1]


@pytest.mark.parametrize("search", get_args(SearchName))
@pytest.mark.parametrize("space", get_args(SpaceName))
def test_the_words_of_a_label_leave_an_edit_unchanged(search: SearchName, space: SpaceName) -> None:
    spec = AttackSpec(search=search, space=space, naturalness=95.0, edit="rear_window.slope_rad:-1")
    words = dataclasses.replace(spec, edit="").label.replace("_", " ")
    assert label_words(spec.label) == f"{words} rear_window.slope_rad:-1"


def test_a_spec_of_the_version_before_is_read_by_todays_names() -> None:
    spec = dataclasses.replace(
        SPEC,
        effects=("no_return_beams", "fog"),
        attack=dataclasses.replace(SPEC.attack, selection_window=2),
        transfer_scenes=(TransferScene("street_001", "b", ("no_return_beams",)),),
    )
    former = spec.to_dict() | {"spec_version": 5, "effects": ["silent_beams", "fog"]}
    former["attack"]["steady_steps"] = former["attack"].pop("selection_window")
    former["attack"]["sphere_m"] = 7.0
    former["transfer_scenes"] = [{"scene": "street_001", "scene_hash": "b", "effects": ["silent_beams"]}]
    assert TaskSpec.from_dict(former) == spec


@pytest.mark.parametrize("version", [4, spec_module.SPEC_VERSION + 1, True, "6", None])
def test_a_spec_of_a_version_that_cannot_be_read_is_refused(version: object) -> None:
    with pytest.raises(ValueError, match=rf"version {version}, this program reads 5 to {spec_module.SPEC_VERSION}"):
        TaskSpec.from_dict(SPEC.to_dict() | {"spec_version": version})


@pytest.mark.parametrize("version", [5, spec_module.SPEC_VERSION])
def test_specs_of_all_versions_stay_readable_when_the_version_is_raised(
    version: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = SPEC.to_dict() | {"spec_version": version}
    if version == 5:
        values["attack"]["sphere_m"] = 7.0
    monkeypatch.setattr(spec_module, "SPEC_VERSION", spec_module.SPEC_VERSION + 1)
    assert TaskSpec.from_dict(values) == SPEC


def test_pose_has_no_lambda() -> None:
    one, ten = (dataclasses.replace(SPEC, mode="pose", lambda_=value) for value in (1.0, 10.0))
    assert one.lambda_ is None
    assert one.task_id == ten.task_id != SPEC.task_id


def test_the_attacked_detector_is_the_first_that_scores() -> None:
    named = dataclasses.replace(SPEC, scored_by=("sst", "pointpillars"))
    assert named.scored_by == ("pointpillars", "sst") and SPEC.scored_by == ("pointpillars",)
    assert dataclasses.replace(SPEC, scored_by=("pointpillars",)).task_id == SPEC.task_id
    assert named.task_id == dataclasses.replace(SPEC, scored_by=("sst",)).task_id


def test_json_and_back() -> None:
    spec = dataclasses.replace(SPEC, effects=("rain",), accuracy_settings={"step_m": 0.1})
    back = TaskSpec.from_dict(json.loads(spec.canonical_json()))
    assert back == spec and back.task_id == spec.task_id
    with pytest.raises(ValueError, match="version 99"):
        TaskSpec.from_dict({**spec.to_dict(), "spec_version": 99})


def test_order_of_arguments_is_no_part_of_the_id() -> None:
    one = dataclasses.replace(SPEC, scene_arguments={"a": 1, "b": 2})
    two = dataclasses.replace(SPEC, scene_arguments={"b": 2, "a": 1})
    assert one.task_id == two.task_id


@pytest.mark.parametrize("name", ["lambda_", "alpha", "detector", "accuracy", "attack", "scored_by"])
def test_tasks_that_are_compared_stand_in_one_place(name: str) -> None:
    other = dataclasses.replace(SPEC, **{name: CHANGES[name]})
    assert other.placement_seed == SPEC.placement_seed
    assert other.task_id != SPEC.task_id


@pytest.mark.parametrize("name", ["base_seed", "replicate", "scene_hash", "vehicle_hash", "placement"])
def test_other_places(name: str) -> None:
    assert dataclasses.replace(SPEC, **{name: CHANGES[name]}).placement_seed != SPEC.placement_seed


def test_scenes_of_transfers_are_part_of_the_id_by_content_and_order() -> None:
    one, two = TransferScene("street_001", "b"), TransferScene("street_002", "c", ("rain",))
    ids = {
        dataclasses.replace(SPEC, transfer_scenes=others).task_id
        for others in ((), (one,), (two,), (one, two), (two, one), (dataclasses.replace(one, scene_hash="d"),))
    }
    assert len(ids) == 6
    spec = dataclasses.replace(SPEC, transfer_scenes=(one, two))
    back = TaskSpec.from_dict(json.loads(spec.canonical_json()))
    assert back == spec and back.task_id == spec.task_id
    assert dataclasses.replace(spec, mode="pose").transfer_scenes == ()


def test_a_transfer_has_a_place_of_its_own_whatever_the_search() -> None:
    other = TransferScene("street_001", "b")
    spec = dataclasses.replace(SPEC, transfer_scenes=(other,), scene_hash="a")
    there = spec.moved_to(other)
    assert (there.scene, there.scene_hash, there.transfer_scenes) == ("street_001", "b", ())
    own_task = dataclasses.replace(SPEC, scene="street_001", scene_hash="b")
    assert there.placement_seed not in (own_task.placement_seed, spec.placement_seed)
    for name in ("lambda_", "alpha", "accuracy", "attack", "detector"):
        same = dataclasses.replace(spec, **{name: CHANGES[name]}).moved_to(other)
        assert same.placement_seed == there.placement_seed
    from_elsewhere = dataclasses.replace(spec, scene_hash="c").moved_to(other)
    assert from_elsewhere.placement_seed != there.placement_seed
