"""``shift3d scenes``: names, findings, a picture, and the words of a sweep."""

from __future__ import annotations

from pathlib import Path

import pytest
from argoverse2_log import LOG, PERIOD, START, write_log
from matplotlib.image import imread

from shift3d.cli.commands.scenes import scenes_words
from shift3d.cli.main import main, parse


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The words for a log of three sweeps."""
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "val", sweeps=3)
    return ["scenes=argoverse2", "scenes.root=val"]


def test_list_prints_the_names_that_a_sweep_takes(log: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    names = [f"{LOG}-{START + sweep * PERIOD}" for sweep in range(3)]
    assert main(["scenes", "list", *log]) == 0
    assert capsys.readouterr().out.splitlines() == [*names, "3 scenes of argoverse2"]
    assert main(["scenes", "list", *log, f"scenes.names=[{names[2]},{names[0]}]"]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == [names[2], names[0]]
    assert main(["scenes", "list", *log, "scenes.count=1"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 scene of argoverse2"


@pytest.mark.parametrize(("words", "scenes"), [([], 4), (["scenes=street_val"], 56)])
def test_without_a_count_there_are_as_many_streets_as_the_option_says(
    words: list[str], scenes: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scenes", "list", *words]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"{scenes} scenes of street-mixed"


def test_show_says_what_was_found_and_draws_it(log: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    name = f"{LOG}-{START + PERIOD}"
    assert main(["scenes", "show", *log, f"scene={name}", "out=pictures/scene.png"]) == 0
    printed = capsys.readouterr().out
    for part in (name, "5,760; ranges", "places, up to", "1 pedestrian, 1 vehicle", "sensor at 9.0 m/s", "of 400 free"):
        assert part in printed
    assert main(["scenes", "show", *log, f"scene={name}", "attack.placement.attempts=9"]) == 0
    assert "of 9 free" in capsys.readouterr().out
    picture = imread("pictures/scene.png")
    assert picture[..., :3].std() > 0.02 and picture.shape[1] > 1000


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "no action is given. Give one of: list, show"),
        (["draw"], "Give one of: list, show"),
        (["list", "scenes=argoverse2"], "scenes.root is required"),
        (["list", "scenes=argoverse", "scenes.root=val"], "Did you mean 'argoverse2'"),
        (["list", "scenes=argoverse2", "scenes.root=nowhere"], "no logs"),
        (["list", "scenes=argoverse2", "scenes.root=val", "scenes.evry=2"], "unknown setting 'scenes.evry'"),
        (["list", "scenes=argoverse2,kitti", "scenes.root=val"], "several values"),
        (["list", "scenes=argoverse2", "scenes.root=val", "vehicle=suv"], "cannot read 'vehicle=suv'"),
        (["list", "scenes=argoverse2", "scenes.root=val", "out=x.png"], "out= means nothing"),
        (["show", "scenes=argoverse2", "scenes.root=val", "out=x.jpg"], "no name of a PNG"),
        (["show", "scenes=argoverse2", "scenes.root=val", "scene=x"], "unknown scene 'x'"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    log: list[str], words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scenes", *words]) == 2
    printed = capsys.readouterr().err
    assert any(part in printed for part in says.split("|")) and printed.count("\n") == 1
    assert "sweep retrieval" not in printed, "a sweep that the user did not name"


def test_completion_offers_actions_data_sets_and_their_settings() -> None:
    assert scenes_words("", parse(["scenes"])) == ["list", "show"]
    begun = parse(["scenes", "list"])
    assert {"scenes=waymo", "scenes=nuscenes", "scenes=openpcdet"} <= set(scenes_words("scenes=", begun))
    assert {"scenes.lasers=", "scenes.sweeps="} <= set(scenes_words("scenes.", begun))
    assert scenes_words("vehicle", begun) == []
