"""Frames of two data sets, or of two folders of one, may have one name: each frame is a scene of its own."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import valid_sweeps

from shift3d.errors import InputError
from shift3d.finetuning.objects import SweepObject, SweepObjects
from shift3d.finetuning.tune import natural_scenes
from shift3d.task.spec import TaskSpec
from shift3d.training.detector_scenes import load_cached
from shift3d.training.provenance import refuse_tuned_scenes, shared_scenes, trained_frames, write_provenance

NAME = "000000"


class _Assets:
    """Scenes of one folder, which differ in their number of points."""

    def __init__(self, points: int) -> None:
        self.points = points

    def scene(self, spec: TaskSpec) -> tuple[Any, None]:
        points = np.ones((self.points, 3), dtype=np.float32)
        labels = SimpleNamespace(of_class=lambda _: np.zeros((0, 7)))
        scene = SimpleNamespace(points=points, ground_z_m=-1.7, labels=labels, has_beam=np.ones(self.points, bool))
        return scene, None


def _found(*scenes: tuple[str, str]) -> SweepObjects:
    """Return two objects per scene, given by data set and content hash."""
    rows = []
    for assets, (dataset, scene_hash) in enumerate(scenes):
        for alpha in (0.1, 0.2):
            spec = TaskSpec("suv", NAME, dataset, "shape", 1.0, alpha, "pointpillars", "draft", scene_hash=scene_hash)
            rows.append(SweepObject(spec, assets, {"method": "adversarial", "replicate": 0}, 0.5, True))
    held = {number: cast(Any, _Assets(number + 1)) for number in range(len(scenes))}
    return SweepObjects(cast(Any, None), valid_sweeps.plan(), tuple(rows), _assets=held)


def test_each_is_trained_on_and_refused_afterwards(tmp_path: Path) -> None:
    found = _found(("kitti", "aa"), ("openpcdet", "bb"), ("kitti", "cc"))
    files = natural_scenes(tmp_path, found)
    assert [len(load_cached(file).points) for file in files] == [1, 2, 3]
    assert found.scenes == [("kitti", NAME, "aa"), ("openpcdet", NAME, "bb"), ("kitti", NAME, "cc")]


def test_a_street_under_two_weathers_is_one_place_and_two_scenes() -> None:
    """Intervals redraw whole places; a gain is of the objects with the same vehicle, place and settings."""
    dry, fog = (
        SweepObject(
            TaskSpec("suv", f"street-test-hdl64-000000{tag}", f"street-hdl64{tag}", "shape", 1.0, 0.1, "sst", "draft"),
            0,
            {"method": "adversarial", "replicate": 0},
            0.5,
            True,
        )
        for tag in ("", "-fog50")
    )
    assert dry.place == fog.place == "street-hdl64/street-test-hdl64-000000"
    assert dry.settings != fog.settings


@pytest.mark.parametrize(
    ("seen", "measured", "shared"),
    [
        ("street-hdl64 street-train-hdl64-000001 aa", "street-hdl64-fog50 street-train-hdl64-000001-fog50 bb", True),
        ("street-hdl64 street-train-hdl64-000001 aa", "street-mixed street-train-hdl64-000001 bb", True),
        ("? street-train-hdl64-000001 aa", "street-hdl64-fog50 street-train-hdl64-000001-fog50 bb", True),
        ("street-hdl64 street-train-hdl64-000001 aa", "street-hdl64 street-train-hdl64-000001-seed3 bb", False),
        ("kitti 000000 aa", "kitti 000001 aa", True),
        ("kitti 000000 aa", "openpcdet 000000 aa", True),
        ("kitti 000000 ?", "kitti 000001 ?", False),
        ("kitti 000000 aa", "kitti 000000 ?", True),
        ("kitti 000000 aa", "openpcdet 000000 bb", False),
        ("? 000000 aa", "openpcdet 000000 bb", True),
    ],
)
def test_a_scene_is_seen_by_its_data_set_and_name_its_street_or_its_content(
    seen: str, measured: str, shared: bool
) -> None:
    """A question mark represents an unknown value."""
    one, other = (cast(Any, tuple(text.replace("?", "").split(" "))) for text in (seen, measured))
    assert shared_scenes([one], [other]) == ([other[1]] if shared else [])


@pytest.mark.parametrize("scenes", [{NAME: "aa"}, [["kitti", NAME, "aa"]]])
def test_weights_are_refused_on_what_they_were_tuned_on(tmp_path: Path, scenes: Any) -> None:
    """Older files state no data set."""
    write_provenance(tmp_path / "w.safetensors", {"before": {"finetuned_on": {"scenes": scenes}}})
    refuse_tuned_scenes(tmp_path / "w.safetensors", [("kitti", "000001", "")])
    with pytest.raises(InputError, match=f"was fine-tuned on {NAME}"):
        refuse_tuned_scenes(tmp_path / "w.safetensors", [("kitti", NAME, "")])


def test_frames_that_weights_were_trained_on_are_known(tmp_path: Path) -> None:
    """Streets have no names in a provenance; frames of the weights at the start count."""
    frames = {"scenes": {"dataset": "kitti", "count": 1, "names": [NAME]}, "before": {"scenes": {"count": 400}}}
    measured = [("kitti", NAME, ""), ("kitti", "000001", ""), ("openpcdet", NAME, "")]
    for facts, known in ((frames, [NAME]), ({"before": frames}, [NAME]), ({}, [])):
        write_provenance(tmp_path / "w.safetensors", facts)
        assert trained_frames(tmp_path / "w.safetensors", measured) == known
    assert trained_frames(tmp_path / "none.safetensors", measured) == []


def test_one_scene_keeps_its_name(tmp_path: Path) -> None:
    (file,) = natural_scenes(tmp_path, _found(("kitti", "aa")))
    assert file.name == f"{NAME}.npz"
