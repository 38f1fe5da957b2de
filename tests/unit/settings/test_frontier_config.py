"""sweeps/accuracy_time.yaml: its settings are valid, named, and numerous enough."""

from __future__ import annotations

from typing import Any

import pytest

from shift3d.cli.commands.frontier import groups_of, plan_of
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.render.settings import PRESETS, RenderSettings
from shift3d.settings.accuracy_time import FrontierSweepConfig, expand_settings, validate_frontier
from shift3d.settings.catalogue.reading import accuracy_settings
from shift3d.settings.compose import compose_sweep
from shift3d.task.assets import render_settings
from shift3d.task.spec import TaskSpec


def frontier(*overrides: str) -> FrontierSweepConfig:
    return validate_frontier(compose_sweep("accuracy_time", overrides).base, "sweep accuracy_time")


def changed(**changes: Any) -> FrontierSweepConfig:
    """Return the sweep with one more setting."""
    values = compose_sweep("accuracy_time", []).base
    plain = {"name": "another", "method": "more", "preset": "standard"}
    values["frontier"]["settings"].append(plain | changes)
    return validate_frontier(values, "here")


def render_settings_of(accuracy: dict[str, Any]) -> RenderSettings:
    names = ("vehicle", "scene", "dataset", "detector", "accuracy")
    spec = TaskSpec(**dict.fromkeys(names, "x"), mode="shape", lambda_=1.0, alpha=0.01, accuracy_settings=accuracy)
    return render_settings(spec)


def test_its_settings_are_unique_valid_and_many() -> None:
    pairs = expand_settings(frontier().frontier)
    names = [setting.name for setting, _ in pairs]
    assert len(set(names)) == len(names) >= 24
    for _, accuracy in pairs:
        render_settings_of(accuracy_settings(accuracy))


def test_the_four_presets_are_there_as_they_ship() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    found = {setting.preset: setting for setting in plan.settings if setting.preset}
    assert found.keys() == PRESETS.keys()
    for name, setting in found.items():
        assert setting.name == name and setting.warm == "no"
        assert render_settings_of(dict(setting.accuracy)) == PRESETS[name]
    # The published method shows the detector the whole scene.
    assert found["paper"].crop_m is None and found["standard"].crop_m is not None


def test_rows_of_one_method_differ_in_their_knob_alone() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    lines: dict[str, list[Any]] = {}
    for setting in plan.settings:
        if setting.knob is not None:
            lines.setdefault(setting.method, []).append(setting)
    assert {"plain sphere tracing", "step", "tolerance", "grazing intersections", "minimum |n.d|"} <= lines.keys()
    assert {"final Newton threshold", "warm start's change", "detector crop"} <= lines.keys()
    for members in lines.values():
        knob = members[0].knob_name
        rest = [{k: v for k, v in dict(s.accuracy).items() if k != knob} for s in members]
        assert len({s.knob for s in members}) == len(members) > 2
        assert all(s.knob_name == knob and other == rest[0] for s, other in zip(members, rest))
        if knob != "crop_m":
            assert [s.accuracy[knob] for s in members] == [s.knob for s in members]


def test_steps_and_starts_that_the_project_claims_something_about_are_there() -> None:
    names = {setting.name for setting, _ in expand_settings(frontier().frontier)}
    assert {f"plain sphere tracing, step {step} m" for step in ("0.04", "0.02", "0.01", "0.005")} <= names
    assert {"standard, warm", "standard, warm pose", "standard in float64", "whole scene", "crop 8 m"} <= names


def test_a_warm_row_has_a_cold_one_under_the_same_conditions_beside_it() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    by_name = {setting.name: setting for setting in plan.settings}
    pairs = [
        ("standard, warm", "standard, shape gradient"),
        ("standard, warm pose", "standard, pose gradient"),
        ("standard, warm pose without grid", "standard without grid, pose gradient"),
    ]
    for warm, cold in pairs:
        one, other = by_name[warm], by_name[cold]
        assert (one.variable, one.grid, one.accuracy) == (other.variable, other.grid, other.accuracy)
        assert one.warm != "no" and other.warm == "no"


def test_paper_as_published_and_on_the_chord_differ_in_that_alone() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    by_name = {setting.name: setting for setting in plan.settings}
    paper, chord = by_name["paper"], by_name["paper, sphere chord only"]
    assert dict(chord.accuracy) == {**paper.accuracy, "sphere_chord_only": True}
    assert (chord.crop_m, chord.displaced, chord.grid) == (paper.crop_m, paper.displaced, paper.grid)


def test_what_attacks_reach_is_measured_for_each_minimum_of_n_dot_d() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    assert [s.accuracy["min_n_dot_d"] for s in plan.settings if s.attack_steps] == [0.0, 0.05, 0.2]


def test_settings_that_render_alike_are_measured_once() -> None:
    plan, _ = plan_of(frontier(), None, quick=False)
    by_name = {setting.name: setting for setting in plan.settings}
    standard = by_name["standard"].rendering_key
    assert all(by_name[name].rendering_key == standard for name in ("crop 5 m", "whole scene", "detector in float64"))
    without_grid = ("standard without grid", "step 0.02 m", "tolerance 3e-06 m", "grazing 0.003 m")
    assert len({by_name[name].rendering_key for name in without_grid}) == 1
    others = ("standard, warm", "standard without grid", "standard in float64", "standard, pose gradient")
    assert standard not in {by_name[name].rendering_key for name in others}
    assert len({by_name[name].step_key for name in ("crop 5 m", "crop 12 m", "whole scene", "standard")}) == 4


def test_what_needs_bfloat16_is_left_out_and_named_where_it_would_be_slow(monkeypatch: pytest.MonkeyPatch) -> None:
    for fast in (True, False):
        monkeypatch.setattr("shift3d.processor.has_fast_bfloat16", lambda fast=fast: fast)
        monkeypatch.setattr("shift3d.settings.catalogue.reading.has_fast_bfloat16", lambda fast=fast: fast)
        plan, left_out = plan_of(frontier(), None, quick=False)
        names = {setting.name for setting in plan.settings}
        wanted = {"detector in bfloat16", "standard, nothing in bfloat16"}
        assert (wanted <= names and not left_out) if fast else (set(left_out) == wanted and not wanted & names)
        if not fast:
            assert all(setting.accuracy["detector"] != "bfloat16" for setting in plan.settings)
            with pytest.raises(InputError, match="no instructions for bfloat16"):
                plan_of(frontier(), "nothing in bfloat16", quick=False)


def test_quick_and_only_choose() -> None:
    plan, _ = plan_of(frontier(), None, quick=True)
    assert len(plan.cases) == 1 and plan.cases[0][1] == max(case.range_m for case in frontier().frontier.cases)
    assert {"paper", "standard", "reference", "draft"} <= {setting.name for setting in plan.settings}
    plan, _ = plan_of(frontier(), "^plain", quick=False)
    assert all(setting.name.startswith("plain") for setting in plan.settings)
    for pattern in ("no such setting", "("):
        with pytest.raises(InputError):
            plan_of(frontier(), pattern, quick=False)
    with pytest.raises(InputError, match=r"'minimum' is in frontier\.quick"):
        plan_of(frontier(), "minimum", quick=True)


def test_kitti_is_a_second_set_or_the_only_one(tmp_path: Any) -> None:
    root = tmp_path / "training" / "velodyne"
    root.mkdir(parents=True)
    (root / "000001.bin").write_bytes(bytes(16))
    for folder in ("label_2", "calib"):
        (tmp_path / "training" / folder).mkdir()
    both = groups_of(frontier(f"frontier.kitti={tmp_path}"))
    alone = groups_of(frontier("scenes=kitti", f"scenes.root={tmp_path}", "scenes.count=5"))
    assert [group.name for group in both] == ["street", "kitti"] and [group.name for group in alone] == ["kitti"]
    half_width = [group.spec.placement.sector_half_width_rad for group in both]
    assert half_width[1] < half_width[0]  # KITTI is labelled in the camera's view alone


def test_weights_that_are_given_are_those_that_are_measured() -> None:
    for setting in ("detector.weights", "+detector.other_weights.pointpillars"):
        (group,) = groups_of(frontier(f"{setting}=mine"))
        assert group.assets.detectors == {"pointpillars": "mine"}


def test_whole_numbers_are_given_over_a_setting_that_counts() -> None:
    written = expand_settings(changed(name="every {}", over={"warm_refresh": [20, 40]}).frontier)
    assert [pair[0].render["warm_refresh"] for pair in written if pair[0].name.startswith("every")] == [20, 40]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nome": 1}, "there is no setting"),
        ({"name": "standard"}, "two settings are called 'standard'"),
        ({"name": "draft", "preset": "draft", "render": {"step_m": 1.0}}, "preset's name"),
        ({"render": {"stepp_m": 0.1}}, "Did you mean 'step_m'"),
        ({"render": {"step_m": "wide"}}, "not float"),
        ({"over": {"step_m": [0.1, 0.2]}}, "no place for step_m"),
        ({"name": "{}", "over": {"max_iterations": [20.6]}}, r"max_iterations is 20\.6, not int"),
        ({"name": "{}", "over": {"step_m": []}}, "at least 1 item"),
        ({"name": "{} m", "over": {"crop_m": [8, 0]}}, "crop_m is 0 in '{} m'. Give radii above 0"),
        ({"name": "{}", "over": {"step_m": [0.1], "batch": [1]}}, "at most 1 item"),
        ({"warm": "yes"}, "One of: no, shape, pose"),
        ({"gradient": "both"}, "One of: no, shape, pose"),
        ({"render": {"grazing_floor": 0.0}}, "is called min_n_dot_d"),
        ({"name": "draft", "preset": "draft", "gradient": "pose"}, "preset's name"),
        ({"preset": "standart"}, "Did you mean 'standard'"),
        ({"crop_m": 0.0}, "greater than 0"),
        ({"name": "step {} m", "over": {"step_m": [float("inf")]}}, "input should be a finite number"),
        ({"name": "step {} m", "over": {"step_m": [float("nan")]}}, "input should be a finite number"),
    ],
)
def test_what_cannot_be_measured_is_said_in_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        expand_settings(changed(**changes).frontier)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sweep", "accuracy_time"], "shift3d frontier"),
        (["plan", "accuracy_time"], "shift3d frontier"),
        (["frontier", "--only", "("], "no regular expression"),
        (["frontier", "vehicle=coupe,suv"], "vehicle has several values"),
        (["frontier", "frontier.repeats=0"], "frontier.repeats is 0"),
        (["frontier", "frontier.repeat=3"], "Did you mean 'frontier.repeats'"),
        (["frontier", "kitti=/nowhere/at/all"], "/nowhere/at/all"),
        (["frontier", "detector.other_weights.sst=mine"], "measures pointpillars alone. Leave it out"),
    ],
)
def test_the_command_says_what_it_cannot_use(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert message in capsys.readouterr().err
