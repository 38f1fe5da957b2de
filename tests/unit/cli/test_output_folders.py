"""Output folders of a command: an unusable one gives one line, before the work begins."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from shift3d.cli.main import main
from shift3d.cli.sweep_arguments import read_words
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.store.resolve import as_location
from shift3d.sweep.planning.folder import open_folder
from shift3d.sweep.planning.plan import make_plan

ONE = ["vehicle=suv", "mode=shape", "attack.lambda=1"]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


RUNS = (["sweep"], ["sweep", "--dry-run"], ["sweep", "plan"], ["plan"])


@pytest.mark.parametrize("command", RUNS, ids=" ".join)
def test_a_folder_that_cannot_be_written_is_one_line(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("text")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("text")
    smoke = [*command, "smoke", "scenes.count=1", *ONE, "runner=local", "tracking=none"]
    places = {
        "file/below": "part of this path is a file",
        "file": "part of this path is a file",
        "/proc/x": "nothing can be written here",
        "/sys/x/y": "nothing can be written here",
        "full": "not empty",
    }
    for place, why in places.items():
        line = refused([*smoke, f"out={place}"], capsys)
        assert why in line and place in line and "out=DIR" in line
    if os.geteuid():
        (tmp_path / "locked").mkdir(mode=0o500)
        assert "no permission" in refused([*smoke, "out=locked/x"], capsys)
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "locked") == ["file", "full"]


@pytest.mark.parametrize("command", RUNS, ids=" ".join)
@pytest.mark.parametrize("word", ["out=", "reuse=", "job=", "scenes.root=", "detector.weights=", "out= ", "scene= "])
def test_an_empty_word_is_an_unset_variable(command: list[str], word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"{word.strip()} is empty" in refused([*command, "smoke", word], capsys)


@pytest.mark.parametrize("command", ["verify", "report", "gc", "compact", "effects"])
@pytest.mark.parametrize("word", ["", " "], ids=["empty", "blank"])
def test_an_empty_word_is_no_folder(command: str, word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "is empty" in refused([command, word], capsys)


@pytest.mark.parametrize("command", RUNS, ids=" ".join)
@pytest.mark.parametrize("key", ["reuse", "timings"])
def test_a_folder_of_another_sweep_is_looked_at_first(
    command: list[str], key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if key == "timings" and command == ["sweep"]:
        return  # this word belongs to plans
    assert main([*command, "smoke", *ONE, f"{key}={tmp_path}"]) == 2
    printed = capsys.readouterr()
    assert "is not the output folder of a sweep" in printed.err and not printed.out


def test_no_key_is_empty(capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["train", "model=sdf", "out="], ["evaluate", "detector=sst", "out="]):
        assert "out= is empty" in refused(words, capsys)


@pytest.mark.parametrize(
    "words",
    [
        ["train", "model=pointpillars", "count=1", "inserted=0", "steps=2", "mlflow=none"],
        ["evaluate", "detector=pointpillars", "count=1"],
        ["fit", "car.glb", "unit=m"],
        ["frontier", "--quick"],
    ],
    ids=lambda words: words[0],
)
def test_other_commands_say_it_before_they_work(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("text")
    for place in ("file/below", "/proc/x", "s3://bucket/x", "~nobody-of-this-name/x"):
        assert place in refused([*words, f"out={place}"], capsys)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


@pytest.mark.parametrize(
    "words",
    [
        ["finetune", "size=small", "out=s3://bucket/x", "--steps"],
        ["compile", "detector=pointpillars", "to=s3://bucket/x.onnx"],
    ],
    ids=lambda words: words[0],
)
def test_a_bucket_is_no_path_of_this_machine(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert "s3://bucket/x" in (line := refused(words, capsys)) and "is no local path" in line


def test_another_option_of_a_group_drops_the_settings_of_the_former_option(tmp_path: Path) -> None:
    words = [*ONE, "runner.workers=2", "tracking.uri=http://mlflow:5000", "attack.steps=3"]
    open_folder(tmp_path / "out", make_plan(compose_sweep("smoke", words), read_catalogue)[0])
    again = read_words([str(tmp_path / "out"), "runner=local", "tracking=none"])
    assert again.overrides == [*ONE, "attack.steps=3", "runner=local", "tracking=none"]
    compose_sweep(again.name, again.overrides)


def test_the_effects_of_an_unfinished_sweep_wait_for_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*ONE, "tracking=none", "runner=local"]
    open_folder(tmp_path / "out", make_plan(compose_sweep("smoke", words), read_catalogue)[0])
    assert "not finished" in (line := refused(["effects", str(tmp_path / "out")], capsys)) and "it resumes" in line


def test_a_sweep_s_name_is_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder with the name of a sweep changes nothing; the folder's path names the sweep that was begun in it."""
    begun = make_plan(compose_sweep("smoke", [*ONE, "tracking=none", "runner=local"]), read_catalogue)[0]
    open_folder(tmp_path / "stability", begun)
    named = read_words(["stability", "vehicle=suv", "out=other"])
    assert (named.name, named.overrides, named.out) == ("stability", ["vehicle=suv"], as_location("other"))
    resumed = read_words(["./stability"])
    assert resumed.name == "smoke" and resumed.out == as_location("./stability")
    line = refused(["plan", "./stability", "out=other"], capsys)
    assert "stability" in line and "Leave out= away" in line


def test_a_word_with_a_slash_is_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A list of sweeps does not help a user who mistyped a folder; it helps one who gave a sweep's file."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "default.yaml").write_text("seed: 0")
    for command in RUNS:
        assert "outputs/nope: is not the output folder" in (line := refused([*command, "outputs/nope"], capsys))
        assert "it does not exist" in line
        assert "it has no spec.yaml" in refused([*command, "./mine"], capsys)
        assert "Did you mean 'default'?" in refused([*command, "mine/default.yaml"], capsys)
