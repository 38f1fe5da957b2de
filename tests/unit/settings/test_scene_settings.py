"""Every data set by its settings: from the words of a sweep to the scenes that a worker loads."""

from __future__ import annotations

from pathlib import Path

import argoverse2_log
import numpy as np
import nuscenes_release
import pytest
import waymo_segment

from shift3d.errors import InputError
from shift3d.settings.compose import compose_sweep, validate
from shift3d.settings.schema.scenes import SceneConfig, scene_config, scene_set


def config(*words: str) -> SceneConfig:
    few = ["vehicle=suv", "mode=shape", "scenes.count=null"]
    return validate(compose_sweep("default", [*few, *words]).base, "here").scenes


def written(root: Path, kind: str) -> list[str]:
    """Write a small data set of a kind. Returns its words."""
    if kind == "waymo":
        waymo_segment.write_segment(root, frames=2)
        return ["scenes.lasers=[TOP,REAR]"]
    if kind == "argoverse2":
        argoverse2_log.write_log(root)
        return ["scenes.every=2"]
    if kind == "nuscenes":
        nuscenes_release.write_release(root)
        return ["scenes.sweeps=2", "scenes.version=v1.0-mini"]
    (root / "points").mkdir()
    np.save(root / "points" / "000007.npy", np.random.default_rng(0).uniform(-20, 20, (900, 4)).clip(-20, 1))
    return ["scenes.sensor_m=[0,0,1.8]", "scenes.ground_z_m=0", "scenes.names=[000007]", "scenes.reflectance_max=1"]


@pytest.mark.parametrize("kind", ["waymo", "argoverse2", "nuscenes"])
def test_settings_give_the_same_scenes_here_and_in_a_worker(tmp_path: Path, kind: str) -> None:
    words = written(tmp_path, kind)
    settings = config(f"scenes={kind}", f"scenes.root={tmp_path}", *words)
    scenes = scene_set(settings)
    assert scenes.dataset == kind
    name = scenes.names()[-1]
    # A worker receives plain values.
    travelled = scene_set(scene_config(settings.model_dump(mode="json")))
    assert travelled.names() == scenes.names()
    assert travelled.load(name).content_hash() == scenes.load(name).content_hash()
    assert travelled.source(name) == scenes.source(name)


def test_frames_of_ones_own_by_number(tmp_path: Path) -> None:
    words = written(tmp_path, "openpcdet")
    settings = config("scenes=openpcdet", f"scenes.root={tmp_path}", *words)
    assert scene_set(settings).names() == ["000007"]
    with pytest.raises(InputError, match="reflectance"):  # uniform over -20 to 1: on no scale
        scene_set(settings).load("000007")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["scenes=waymo", "scenes.lasers=[BACK]"], "REAR"),
        (["scenes=waymo", "scenes.lasers=[]"], "lasers"),
        (["scenes=waymo", "scenes.every=0"], "scenes.every"),
        (["scenes=nuscenes", "scenes.sweeps=0"], "scenes.sweeps"),
        (["scenes=openpcdet", "scenes.sensor_m=[0,0]"], "scenes.sensor_m"),
        (["scenes=argoverse2", "scenes.sweeps=2"], "scenes.sweeps"),
    ],
)
def test_settings_out_of_range_name_themselves(words: list[str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        config("scenes.root=here", *words)


@pytest.mark.parametrize("kind", ["waymo", "argoverse2", "nuscenes", "openpcdet", "kitti"])
def test_a_root_has_to_be_given(kind: str) -> None:
    with pytest.raises(InputError, match=r"scenes\.root is required"):
        config(f"scenes={kind}")
