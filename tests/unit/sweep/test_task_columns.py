"""A plan's tasks as columns: the same tasks, ids and order as one spec after the other, and cheap to share."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import pickle
from typing import Any

import numpy as np
import pytest

from shift3d.errors import InputError
from shift3d.sweep.planning.plan import Plan
from shift3d.sweep.planning.tasks import PlannedTask, Tasks
from shift3d.sweep.planning.tasks_builder import tasks_of
from shift3d.task.spec import AttackSpec, PlacementSpec, TaskSpec, TransferScene

TEXTS = ("", "suv", "a, b", 'quo"te', "back\\slash", "Straße", "\u2028", "車", '{"scene":"x"}', '","scene_hash":"')


def random_spec(rng: np.random.Generator) -> TaskSpec:
    """Return a random spec: texts to escape in JSON, floats of all sizes, nested mappings, transfers or none."""

    def text() -> str:
        return TEXTS[rng.integers(len(TEXTS))] + str(rng.integers(3))

    def number() -> float:
        return float(rng.choice([0.0, -0.0, 0.1, 1.0, 1e-17, 1e22, rng.normal()]))

    def names() -> tuple[str, ...]:
        return tuple(text() for _ in range(rng.integers(3)))

    def mapping() -> dict[str, Any]:
        return {text(): [number(), None, text(), {"b": 1, "a": number()}][rng.integers(4)] for _ in range(3)}

    return TaskSpec(
        vehicle=text(),
        scene=text(),
        dataset=text(),
        mode=str(rng.choice(["shape", "pose"])),  # type: ignore[arg-type]
        lambda_=number(),
        alpha=number(),
        detector=text(),
        accuracy=text(),
        base_seed=int(rng.integers(2**62)),
        effects=names(),
        effect_settings={name: number() for name in names()},
        accuracy_settings=mapping(),
        scene_arguments=mapping(),
        attack=AttackSpec(steps=int(rng.integers(50)), noise_sigma=number()),
        placement=PlacementSpec(contact_m=number()),
        scene_hash=text(),
        vehicle_hash=text(),
        scored_by=names(),
        detector_hashes={name: text() for name in names()},
        transfer_scenes=tuple(TransferScene(text(), text(), names()) for _ in range(rng.integers(3))),
    )


def test_ids_of_many_are_the_ids_of_each() -> None:
    rng = np.random.default_rng(0)
    specs = list({spec.task_id: spec for spec in (random_spec(rng) for _ in range(300))}.values())
    tasks = tasks_of(PlannedTask(spec, 0) for spec in specs)
    assert tasks.ids.to_pylist() == [spec.task_id for spec in specs]
    assert [task.spec for task in tasks] == specs
    # A task carries the id of its spec.
    assert [TaskSpec.from_dict(task.spec.to_dict()).task_id for task in tasks] == tasks.ids.to_pylist()


def test_a_task_that_is_asked_for_again_stands_once_at_its_first_place() -> None:
    rng = np.random.default_rng(1)
    first, second = random_spec(rng), random_spec(rng)
    planned = [(first, "auto"), (second, "none"), (first, "none"), (second, "none"), (first, "auto")]
    tasks = tasks_of(PlannedTask(spec, index, (requested,)) for index, (spec, requested) in enumerate(planned))
    assert list(tasks) == [PlannedTask(first, 0, ("auto", "none")), PlannedTask(second, 1, ("none",))]
    assert tasks.effects_requested_of([second.task_id, first.task_id]) == [["none"], ["auto", "none"]]


def test_a_row_of_a_task_that_the_plan_lacks_is_refused(default_plan: Plan) -> None:
    """The plan has one setting of effects: it is not the setting of a task of another sweep."""
    known = default_plan.tasks.ids[0].as_py()
    assert default_plan.tasks.effects_requested_of([known]) == [["auto"]]
    with pytest.raises(InputError, match=r"^final: 1 row of tasks that the plan does not have\. Restore the folder"):
        default_plan.tasks.effects_requested_of([known, "no task"])


def test_it_is_a_sequence(default_plan: Plan) -> None:
    tasks = default_plan.tasks
    listed = list(tasks)
    assert len(tasks) == len(listed) == 30 and tasks[-1] == listed[-1] and listed[7] in tasks
    assert list(tasks[3:9:2]) == listed[3:9:2] and isinstance(tasks[3:9], Tasks)
    assert list(tasks.select([5, 2])) == [listed[5], listed[2]]
    assert tasks.select(range(30)) == tasks != tasks[:29]
    assert list(tasks.starting_with(tasks.ids[4].as_py()[:12])) == [listed[4]]
    assert tasks.without({listed[1].spec.task_id, "another"}).tolist() == [0, *range(2, 30)]
    with pytest.raises(IndexError):
        tasks[30]
    assert not tasks[:0]


def test_what_does_not_depend_on_the_scene_is_counted_without_a_loop(default_plan: Plan) -> None:
    groups = default_plan.tasks.groups()
    assert [(g.template.vehicle, g.template.mode, g.template.lambda_) for g in groups[:3]] == [
        ("coupe", "shape", 1.0),
        ("coupe", "shape", 10.0),
        ("coupe", "pose", None),
    ]
    assert [group.tasks for group in groups] == [2] * 15
    assert default_plan.tasks.scenes() == [("street-hdl64", "north"), ("street-hdl64", "south")]
    assert [group.template.vehicle for group in default_plan.tasks[28:].groups()] == ["beach_wagon"]


def test_columns_are_pickled_out_of_band(default_plan: Plan) -> None:
    buffers: list[pickle.PickleBuffer] = []
    within = pickle.dumps(default_plan.tasks, protocol=5, buffer_callback=buffers.append)
    ids = default_plan.tasks.ids
    assert sum(buffer.raw().nbytes for buffer in buffers) >= 32 * len(ids)
    assert ids[0].as_py().encode() not in within
    assert pickle.loads(within, buffers=buffers) == default_plan.tasks  # noqa: S301


def test_the_hash_is_of_the_names_and_all_ids_in_order(default_plan: Plan) -> None:
    """The hash also covers a constant 5, for any schema version: folders of older programs keep their names."""
    ids = [task.spec.task_id for task in default_plan.tasks]
    text = json.dumps([5, "default", ids])
    assert default_plan.spec_hash == hashlib.blake2b(text.encode(), digest_size=8).hexdigest()
    assert dataclasses.replace(default_plan, tasks=default_plan.tasks[::-1]).spec_hash != default_plan.spec_hash
