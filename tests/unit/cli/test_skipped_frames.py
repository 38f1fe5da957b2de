"""Unreadable frames: one refuses a sweep, or is left out and listed on request."""

from __future__ import annotations

import shutil
from pathlib import Path

import pandas as pd
import pytest
import valid_frames

from shift3d.cli.main import main
from shift3d.settings.catalogue.reading import read_catalogue
from shift3d.settings.compose import compose_sweep
from shift3d.settings.expand import expand
from shift3d.sweep.planning.folder import read_plan

ONE = ["vehicle=suv", "mode=shape", "attack.lambda=1", "attack.placement.attempts=1", "naturalness=none"]
BAD = {
    "000008": "5 bytes is not a whole number",
    "000009": "the frame is missing",
    "000010": "the calibration file is missing",
    "000011": "unknown class 'Unicorn'",
}


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One good frame and four bad ones."""
    monkeypatch.chdir(tmp_path)
    valid_frames.write_frame(tmp_path)
    folder = tmp_path / "training"
    for name in BAD:
        for path in [folder / "velodyne" / "000007.bin", *folder.glob("*/000007.txt")]:
            shutil.copy(path, path.with_stem(name))
    (folder / "velodyne" / "000008.bin").write_bytes(b"short")
    (folder / "velodyne" / "000009.bin").unlink()
    (folder / "calib" / "000010.txt").unlink()
    (folder / "label_2" / "000011.txt").write_text("Unicorn" + valid_frames.LABELS.splitlines()[0].removeprefix("Car"))
    return tmp_path


def words(root: Path, *more: str) -> list[str]:
    return ["kitti", f"scenes.root={root}", "scenes.count=null", *ONE, "runner=local", "tracking=none", *more]


def all_listed(text: str) -> bool:
    return "4 scenes left out" in text and all(name in text and why in text for name, why in BAD.items())


def test_a_bad_frame_refuses_the_sweep(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *words(root)]) == 2
    assert "000009.bin" in capsys.readouterr().err
    assert main(["plan", *words(root, "scenes.names=[000007,000008]")]) == 2
    printed = capsys.readouterr().err
    assert "5 bytes" in printed and "scenes.skip_bad=true" in printed


def test_bad_frames_are_left_out_and_listed(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    skip = words(root, "scenes.skip_bad=true")
    assert main(["plan", *skip]) == 0
    printed = capsys.readouterr().out
    assert "1 task (1 shape) of 1 vehicle in 1 scene" in printed and all_listed(printed)
    assert main(["sweep", *skip, "out=out"]) == 3, "nothing fits into so small a frame"
    before, after = capsys.readouterr().out.split("writing to out")
    assert all_listed(before) and all_listed(after)
    plan = read_plan("out")
    assert [name for _, name in plan.tasks.scenes()] == ["000007"] and plan.skipped.keys() == BAD.keys()
    table = pd.read_parquet(root / "out" / "final" / "skipped_scenes.parquet")
    assert set(table["sweep"]) == {"kitti"} and dict(zip(table["scene"], table["why"])) == dict(plan.skipped)
    assert all(BAD[scene] in why and str(root) not in why for scene, why in plan.skipped.items())
    assert main(["report", "out"]) == 0
    page = (root / "out" / "report.html").read_text()
    assert all(name in page for name in BAD) and "4 scenes left out" in page
    assert main(["sweep", *skip, "out=out"]) == 3, "the same command again is the same sweep"


@pytest.mark.parametrize("spelled", ["./g", "g//", "g", "../{parent}/g"])
def test_the_reasons_do_not_depend_on_how_the_folder_is_written(root: Path, spelled: str) -> None:
    (root / "g").mkdir()
    (root / "training").rename(root / "g" / "training")
    catalogues = []
    for folder in (str(root / "g"), spelled.format(parent=root.name)):
        settings = words(Path("any"), f"scenes.root={folder}", "scenes.skip_bad=true")[2:]
        (config,) = expand(compose_sweep("kitti", settings))
        catalogues.append(read_catalogue(config, preview=True).skipped)
    assert catalogues[0] == catalogues[1] and catalogues[0].keys() == BAD.keys()
    assert all(why.startswith("training/") for why in catalogues[1].values())


def test_ids_do_not_depend_on_it(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ids = []
    for skip in ("false", "true"):
        assert main(["plan", *words(root, "scenes.names=[000007]", f"scenes.skip_bad={skip}"), "--tasks"]) == 0
        ids.append(capsys.readouterr().out.splitlines()[-1].split()[0])
    assert ids[0] == ids[1]


def test_a_name_that_is_no_frame_is_left_out_too(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *words(root, "scenes.names=[000007,999999]", "scenes.skip_bad=true")]) == 0
    assert "1 scene left out" in capsys.readouterr().out


def test_without_one_good_frame_the_first_reason_is_the_error(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *words(root, "scenes.names=[000008,000010]", "scenes.skip_bad=true")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and "5 bytes" in lines[0]
