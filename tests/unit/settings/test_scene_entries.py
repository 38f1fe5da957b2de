"""Scenes that a plan must open: none whose facts the configuration states, and none twice."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from argoverse2_log import write_log
from nuscenes_release import write_release
from waymo_segment import write_segment

from shift3d.errors import InputError
from shift3d.scenes.argoverse2.scenes import Argoverse2Scenes
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.nuscenes.scenes import NuScenesScenes
from shift3d.scenes.sets import SceneSet, StreetScenes
from shift3d.scenes.waymo.scenes import WaymoScenes
from shift3d.settings.catalogue import scene_entries as module
from shift3d.settings.catalogue.scene_entries import SceneEntry
from shift3d.settings.catalogue.scene_entries import scene_entries as entries_and_skipped


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache"
    monkeypatch.setattr(module, "user_cache", lambda: folder)
    return folder


def scene_entries(scenes: SceneSet, preview: bool = False) -> tuple[SceneEntry, ...]:
    entries, skipped = entries_and_skipped(scenes, preview)
    assert not skipped
    return entries


def unreadable(self: object, name: str) -> None:
    raise AssertionError(f"{name} was looked at")


def test_a_preview_of_many_streets_makes_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StreetScenes, "load", unreadable)
    entries = scene_entries(StreetScenes("mixed", count=500), preview=True)
    assert len(entries) == 500 and not any(entry.content_hash for entry in entries)
    assert {entry.dataset for entry in entries} == {"street-hdl64", "street-waymo_top"}


def test_a_street_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = StreetScenes("mixed", count=2)
    made = scene_entries(scenes)
    assert [entry.content_hash for entry in made] == [scenes.load(name).content_hash() for name in scenes.names()]
    monkeypatch.setattr(StreetScenes, "load", unreadable)
    assert scene_entries(scenes) == made == scene_entries(scenes, preview=True)


def test_no_more_scenes_are_in_memory_at_once_than_this_process_has_cpus(monkeypatch: pytest.MonkeyPatch) -> None:
    """A container has the memory for its share of a machine's CPUs, not for all of them."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
    spans, load = [], StreetScenes.load

    def timed(self: StreetScenes, name: str) -> object:
        began, scene = time.monotonic(), load(self, name)
        spans.append((began, time.monotonic()))
        return scene

    monkeypatch.setattr(StreetScenes, "load", timed)
    scene_entries(StreetScenes("hdl64", seed=7, count=2))  # that no test has made
    first, second = sorted(spans)
    assert first[1] <= second[0]


def test_few_streets_are_made_for_a_preview_too() -> None:
    (entry,) = scene_entries(StreetScenes(count=1), preview=True)
    assert entry.content_hash


def test_another_program_looks_again(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = StreetScenes(count=1)
    scene_entries(scenes)
    monkeypatch.setattr(module, "_program", lambda: "another")
    monkeypatch.setattr(StreetScenes, "load", unreadable)
    with pytest.raises(AssertionError, match="looked at"):
        scene_entries(scenes)


def test_a_frame_is_read_again_where_a_file_changed(
    tmp_path: Path, real_data: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "kitti"
    shutil.copytree(real_data("kitti"), root)
    scenes = KittiScenes(root, ["000001", "000002"])
    first = scene_entries(scenes)
    label = root / "training" / "label_2" / "000002.txt"
    label.write_text(label.read_text() + "DontCare -1 -1 -10 0 0 1 1 -1 -1 -1 -1000 -1000 -1000 -10\n")
    looked_at, load = [], KittiScenes.load
    monkeypatch.setattr(KittiScenes, "load", lambda self, name: (looked_at.append(name), load(self, name))[1])
    assert scene_entries(scenes) == first and looked_at == ["000002"]


def test_without_a_cache_everything_works(cache: Path) -> None:
    cache.write_text("a file where the folder should be")
    scenes = StreetScenes(count=1)
    assert scene_entries(scenes) == scene_entries(scenes)


def test_damaged_entries_are_made_again(cache: Path) -> None:
    scenes = StreetScenes(count=1)
    made = scene_entries(scenes)
    for damage in ("", "{", "[]", '{"name": 3}', "null"):
        (file,) = (cache / "scenes").iterdir()
        file.write_text(damage)
        assert scene_entries(scenes) == made


def test_a_scene_that_cannot_be_read_is_named(tmp_path: Path, real_data: Callable[[str], Path]) -> None:
    root = tmp_path / "kitti"
    shutil.copytree(real_data("kitti"), root)
    (root / "training" / "velodyne" / "000002.bin").write_bytes(b"short")
    with pytest.raises(InputError, match=r"000002\.bin: 5 bytes"):
        scene_entries(KittiScenes(root, ["000001", "000002"]))


def test_a_set_without_scenes_says_nothing_of_bad_ones(tmp_path: Path, real_data: Callable[[str], Path]) -> None:
    root = tmp_path / "kitti"
    shutil.copytree(real_data("kitti"), root)
    (root / "training" / "velodyne" / "000002.bin").write_bytes(b"short")
    with pytest.raises(InputError, match=r"leave such frames out: scenes\.skip_bad=true"):
        entries_and_skipped(KittiScenes(root, ["000002"]), skip_bad=False)
    with pytest.raises(InputError) as unknown:
        entries_and_skipped(KittiScenes(root, ["no frame"]), skip_bad=False)
    with pytest.raises(InputError) as setless:
        entries_and_skipped(KittiScenes(root, ["000002"]))
    assert "skip_bad" not in f"{unknown.value} {setless.value}"


@pytest.mark.parametrize("reader", ["argoverse2", "waymo", "nuscenes"])
def test_a_named_scene_of_a_drive_that_is_not_there_is_left_out(tmp_path: Path, reader: str) -> None:
    write, kind = {
        "argoverse2": (write_log, Argoverse2Scenes),
        "waymo": (write_segment, WaymoScenes),
        "nuscenes": (write_release, NuScenesScenes),
    }[reader]
    write(tmp_path / "root")
    good = kind(tmp_path / "root").names()[0]
    entries, skipped = entries_and_skipped(
        kind(tmp_path / "root", [good, "absent-1"], list_unreadable=True), skip_bad=True
    )
    assert [entry.name for entry in entries] == [good]
    assert list(skipped) == ["absent-1"] and "unknown scene 'absent-1'" in skipped["absent-1"]
