"""Effects chosen by a plan: once for each scene, shown in a table, and part of each task."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import pytest
from by_hand import catalogue

from shift3d.effects.applicability import Choice, choose
from shift3d.errors import InputError
from shift3d.scenes.facts import DetectorFacts, SceneFacts
from shift3d.scenes.scene import Conditions
from shift3d.settings.catalogue.reading import Catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.settings.schema.config import Config
from shift3d.sweep.planning import effect_choices
from shift3d.sweep.planning.effect_choices import effect_table
from shift3d.sweep.planning.plan import Plan, make_plan
from shift3d.sweep.planning.plan_view import plan_summary

FOG = SceneFacts("north", conditions=Conditions(weather="fog", visibility_m=40.0))


def one_foggy(config: Config) -> Catalogue:
    """Return a catalogue in which north is in fog and south is dry."""
    plain = catalogue(config)
    north, south = plain.scenes
    return dataclasses.replace(plain, scenes=(dataclasses.replace(north, facts=FOG), south))


def plan_of(*overrides: str, of=catalogue) -> Plan:  # type: ignore[no-untyped-def]
    return make_plan(compose_sweep("default", ["vehicle=suv", "mode=shape", "attack.lambda=1", *overrides]), of)[0]


def test_auto_on_dry_scenes_asks_for_the_same_tasks_as_none() -> None:
    auto, none = plan_of(), plan_of("effects=none")
    assert [task.spec for task in auto.tasks] == [task.spec for task in none.tasks]
    assert auto.effects == () and effect_table(auto.effects, 2) == "effects: occlusion only; no scene needs another"


def test_auto_takes_what_one_scene_calls_for_there_and_nowhere_else() -> None:
    plan = plan_of(of=one_foggy)
    assert {task.spec.scene: task.spec.effects for task in plan.tasks} == {"north": ("fog",), "south": ()}
    ((choice, scenes),) = plan.effects
    assert (choice.effect, choice.used, scenes) == ("fog", True, ("north",)) and "40 m" in choice.reason
    table = effect_table(plan.effects, 2).splitlines()
    assert "fog" in table[2] and "1 of 2" in table[2] and choice.reason in table[2]


def test_scenes_that_shapes_are_put_into_are_counted_among_those_that_were_asked() -> None:
    summary = plan_summary(plan_of("scene=south", "attack.transfer_scenes=1", of=one_foggy))
    assert "in 1 scene\n" in summary and "1 of 2" in summary


def test_what_is_said_of_scenes_is_part_of_the_tasks_that_use_it() -> None:
    thick, thin = (plan_of("effects=fog", f"effects.visibility_m={metres}") for metres in (30, 60))
    assert thick.tasks[0].spec.effect_settings == {"visibility_m": 30.0}
    assert thick.tasks[0].spec.task_id != thin.tasks[0].spec.task_id
    unused = plan_of("effects=none", "effects.visibility_m=30")
    assert unused.tasks[0].spec.task_id == plan_of().tasks[0].spec.task_id


@pytest.mark.parametrize(
    ("overrides", "unused"),
    [
        (("effects=none", "effects.rain_mm_h=20"), ["rain_mm_h"]),
        (("effects=rain", "effects.rain_mm_h=10", "effects.visibility_m=30"), ["visibility_m"]),
        (("effects=none,rain", "effects.rain_mm_h=10,20"), []),
        (("effects=fog", "effects.visibility_m=30", "effects.limit_range_m=80"), []),
        (("effects=none",), []),
    ],
)
def test_settings_that_no_effect_of_the_sweep_uses_are_named(overrides: tuple[str, ...], unused: list[str]) -> None:
    expected = tuple(f"effects.{name}: no effect of this sweep uses it" for name in unused)
    plan = plan_of(*overrides)
    assert plan.notes == expected
    assert all(line in plan_summary(plan) for line in expected)


def test_an_effect_without_data_is_refused_with_what_would_supply_it() -> None:
    with pytest.raises(InputError, match=r"north has no data for fog: its visibility.*effects\.visibility_m"):
        plan_of("effects=fog")


def test_settings_of_effects_as_an_axis_and_a_task_that_two_of_them_share() -> None:
    plan = plan_of("effects=auto,none,[rain]", "effects.rain_mm_h=25")
    requested = {(task.spec.scene, task.spec.effects): task.effects_requested for task in plan.tasks}
    assert requested["south", ()] == ("none",) and requested["south", ("rain",)] == ("auto", "rain")


def test_scenes_are_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    requested: list[str] = []

    def counting(wanted: str | Sequence[str], scene: SceneFacts, detector: DetectorFacts) -> list[Choice]:
        requested.append(scene.scene_id)
        return choose(wanted, scene, detector)

    monkeypatch.setattr(effect_choices, "choose", counting)
    plan_of("attack.lambda=1,10", "attack.alpha=0.01,0.02", of=one_foggy)
    assert requested == ["north", "north", "south", "south"]  # effects called for, and forced effects


def test_a_misspelt_effect_is_told_the_nearest_and_nothing_internal() -> None:
    with pytest.raises(InputError, match=r"unknown effects 'fogg'\. Did you mean 'fog'\? One of: auto, "):
        plan_of("effects=fogg")
