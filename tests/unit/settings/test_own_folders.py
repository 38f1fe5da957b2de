"""A user's own sweeps, groups and launch specs: found first, beside the shipped ones; missing ones are reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from shift3d.cli.completion import overrides, plan_words
from shift3d.cli.job_spec import pop_job
from shift3d.cli.main import main
from shift3d.cli.sweep_arguments import compose_runner
from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep
from shift3d.settings.expand import expand
from shift3d.settings.folders import files, own_folders, places, shipped


@pytest.fixture
def team(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which a command runs; every sign of its name means something in Hydra's grammar."""
    folder = tmp_path / "a team's folder, 2 = two"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def steps(name: str, *words: str) -> set[int]:
    return {config.attack.steps for config in expand(compose_sweep(name, words))}


def test_an_empty_folder_has_what_ships(team: Path) -> None:
    assert {"default", "smoke"} <= set(files("sweeps")) and steps("smoke") == {5}
    assert own_folders() == [] and [folder.is_dir() for folder in places("sweeps")] == [False, True]


def test_a_sweep_and_an_option_of_ones_own_stand_beside_those_that_ship(team: Path) -> None:
    write(team / "sweeps" / "mine.yaml", "defaults: [/config, override /attack: tiny, _self_]\nscenes: {count: 2}\n")
    write(team / "conf" / "attack" / "tiny.yaml", "defaults: [paper, _self_]\nsteps: 3\n")
    assert steps("mine") == {3} and steps("smoke", "attack=tiny") == {3} and steps("mine", "attack=short") == {5}
    assert steps("smoke", "attack=short,tiny") == {3, 5}, "an option of one's own is a value of an axis"
    assert steps("smoke", "attack=glob(t*)") == {3}
    assert compose_sweep("mine").base["scenes"]["count"] == 2
    assert [folder.name for folder in own_folders()] == ["sweeps", "conf"]


def test_a_file_of_ones_own_takes_the_place_of_its_name(team: Path) -> None:
    before = steps("smoke")
    write(team / "conf" / "attack" / "short.yaml", "defaults: [paper, _self_]\nsteps: 2\n")
    assert (before, steps("smoke")) == ({5}, {2})
    write(team / "sweeps" / "smoke.yaml", "defaults: [/config, _self_]\nattack: {steps: 4}\n")
    assert steps("smoke") == {4}


def test_a_sweep_of_ones_own_changes_no_command_that_runs_another(
    team: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """scenes and verify take their settings from conf/ through a sweep that nobody named."""
    assert main(["scenes", "list"]) == 0
    shipped_scenes, runner = capsys.readouterr().out, compose_runner(["runner.workers=2"], "verify")
    for text in ("scenes: [", "defaults: [/config, override /scenes: kitti, _self_]\nrunner: {kind: 3}"):
        for name in files("sweeps"):
            write(team / "sweeps" / f"{name}.yaml", text)
        assert main(["scenes", "list"]) == 0 and capsys.readouterr().out == shipped_scenes
        assert compose_runner(["runner.workers=2"], "verify") == runner
    write(team / "conf" / "runner" / "ray.yaml", "defaults: [local, _self_]\n")
    assert compose_runner([], "verify") == compose_runner(["runner=local"], "verify"), "an option of one's own counts"


def test_a_sweep_may_be_made_of_one_that_ships(team: Path) -> None:
    write(team / "sweeps" / "mine.yaml", "defaults: [smoke, _self_]\nattack: {steps: 1}\n")
    configs = list(expand(compose_sweep("mine")))
    assert {(config.vehicle.name, config.mode, config.attack.steps) for config in configs} == {
        (vehicle, mode, 1) for vehicle in ("coupe", "suv") for mode in ("shape", "pose")
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("scenes: {count: 3}\n", r"sweep mine: it does not say vehicle, .*Begin its file with `defaults: \[/config"),
        (
            "defaults: [smoke, _self_]\nscenes: {cuont: 3}\n",
            r"no setting scenes\.cuont\. Did you mean 'scenes\.count'\? One of: scenes\.beams, ",
        ),
        (
            "defaults: [/sweeps/smoke, _self_]\n",
            r"no group 'sweeps' with 'smoke'. Name a sweep alone, as in `- default`",
        ),
    ],
)
def test_a_sweeps_file_with_a_mistake_is_refused_with_what_it_needs(team: Path, text: str, message: str) -> None:
    write(team / "sweeps" / "mine.yaml", text)
    with pytest.raises(InputError, match=message):
        list(expand(compose_sweep("mine")))


def test_a_group_that_shift3d_does_not_have_is_refused(team: Path) -> None:
    write(team / "conf" / "weather" / "wet.yaml", "rain: 1\n")
    with pytest.raises(InputError, match="there is no setting weather"):
        list(expand(compose_sweep("smoke", ["+weather=wet"])))


@pytest.mark.parametrize("words", ["mine", "mine,coupe", "coupe,mine"])
def test_an_interpolation_is_refused_in_every_option_of_an_axis(team: Path, words: str) -> None:
    write(team / "conf" / "vehicle" / "mine.yaml", "{kind: set, name: suv, folder: '${oc.env:HOME}/cars'}\n")
    with pytest.raises(InputError, match=r"vehicle\.folder holds an interpolation"):
        compose_sweep("smoke", [f"vehicle={words}"])


def test_another_programs_settings_are_not_taken_for_ours(team: Path) -> None:
    write(team / "conf" / "config.yaml", "defaults: [model: resnet]\n")
    with pytest.raises(InputError, match=r"\./conf/config\.yaml: it would take the place of shift3d's own.*another"):
        compose_sweep("smoke")
    write(team / "conf" / "config.yaml", (shipped("conf") / "config.yaml").read_text())
    assert steps("smoke") == {5}, "a copy of all that ships"


@pytest.mark.parametrize(
    ("words", "name", "folder"),
    [
        (["sweep", "mne"], "'mine'", "sweeps"),
        (["sweep", "mine", "attack=tinny"], "'tiny'", "conf/attack"),
        (["sweep", "mine", "effects=[fogg]"], "'fog'", "conf/effects"),
        (["sweep", "mine", "effects=null"], "auto", "conf/effects"),
        (["sweep", "mine", "job=moon"], "my_cluster", "jobs"),
        (["jobs", "moon"], "my_cluster", "jobs"),
    ],
)
def test_an_unknown_name_says_what_there_is_and_where_it_was_looked_for(
    words: list[str], name: str, folder: str, team: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(team / "sweeps" / "mine.yaml", "defaults: [/config, _self_]\n")
    write(team / "conf" / "attack" / "tiny.yaml", "defaults: [paper, _self_]\n")
    write(team / "jobs" / "my_cluster.yaml", "kind: local\nrunner:\n  kind: local\n")
    assert main(words) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert name in line and line.endswith(f"Looked in ./{folder} and {shipped(folder)}")


def test_a_launch_spec_of_ones_own(team: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(team / "jobs" / "local.yaml", "# Ours.\nkind: local\nrunner:\n  kind: local\n")
    job, _ = pop_job(["job=local"])
    assert job is not None and job.runner == {"kind": "local"}
    assert main(["jobs"]) == 0
    listed = capsys.readouterr().out
    assert "./jobs/local.yaml" in listed and str(shipped("jobs") / "kuberay.yaml") in listed
    assert main(["jobs", "slurm.sbatch"]) == 0
    assert capsys.readouterr().out == (shipped("jobs") / "slurm.sbatch").read_text()


def test_the_shell_is_offered_both(team: Path) -> None:
    write(team / "sweeps" / "mine.yaml", "defaults: [/config, _self_]\n")
    write(team / "conf" / "attack" / "tiny.yaml", "defaults: [paper, _self_]\n")
    write(team / "jobs" / "my_cluster.yaml", "kind: local\nrunner:\n  kind: local\n")
    assert {"mine", "smoke"} <= set(plan_words(""))
    assert set(overrides("attack=")) == {"attack=paper", "attack=short", "attack=tiny"}
    assert {"job=my_cluster", "job=local"} <= set(plan_words("job="))
    assert {"attack.steps="} == set(overrides("attack.steps"))
    assert overrides("attack=paper,s") == ["attack=paper,short"], "the last value of an axis"
    assert set(overrides("attack=paper,")) == {"attack=paper,short", "attack=paper,tiny"}
