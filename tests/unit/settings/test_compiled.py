"""An ONNX file among the settings: refusals at planning time, and the comparison with its original."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import valid_settings
from onnx_files import OWN_SOURCE, write_model
from valid_frames import NAME, street, write_frame

from shift3d.errors import InputError
from shift3d.scenes.kitti.scenes import KittiScenes
from shift3d.scenes.sets import StreetScenes
from shift3d.settings.catalogue.compiled import compare_with_original, refuse_gradient_search
from shift3d.settings.catalogue.detector_files import detector_hash, scoring_detectors
from shift3d.settings.compose import validate
from shift3d.settings.schema.config import Config, DetectorConfig
from shift3d.sweep.execution.ray.shipped_files import named_files
from shift3d.task.exchange import AssetsSpec


def configured(search: str = "evolution", **detector: Any) -> Config:
    values = valid_settings.settings()
    values["detector"] = {"name": "onnx", "scored_by": [], "other_weights": {}, "file": "mine.onnx", **detector}
    values["attack"]["search"] = search
    return validate(values, "sweep mine")


@pytest.mark.parametrize("search", ["descent", "expectation"])
def test_a_search_with_gradients_is_refused_with_the_remedy(search: str) -> None:
    with pytest.raises(InputError, match=rf"search={search} follows a gradient.*attack\.search=evolution, or random"):
        refuse_gradient_search(configured(search))


def test_the_search_over_kinds_without_a_gradient_is_random() -> None:
    """Evolution stays with one kind, so it is no remedy."""
    config = configured("expectation")
    config = config.model_copy(update={"attack": config.attack.model_copy(update={"space": "family"})})
    with pytest.raises(InputError, match=r"Give attack\.search=random$"):
        refuse_gradient_search(config)


@pytest.mark.parametrize("search", ["evolution", "random"])
def test_a_search_by_scores_is_taken(search: str) -> None:
    refuse_gradient_search(configured(search))
    assert configured(search).detector.weights_by_name() == {"onnx": "mine.onnx"}


def test_a_users_file_is_searched_with_the_gradients_that_it_gives(tmp_path: Path) -> None:
    """Numpy arrays have no gradient; the logits of `OWN_SOURCE` have one."""
    tensors, arrays = tmp_path / "tensors.py", tmp_path / "arrays.py"
    tensors.write_text(OWN_SOURCE)
    arrays.write_text("import numpy as np\ndef load(weights): return lambda points: (np.ones((1, 7)), np.ones(1))\n")
    refuse_gradient_search(configured("descent", name="own", file=None, module=str(tensors)))
    refuse_gradient_search(configured("evolution", name="own", file=None, module=str(arrays)))
    with pytest.raises(InputError, match=r"=descent follows a gradient, and .*arrays\.py \(numpy arrays\) gives none"):
        refuse_gradient_search(configured("descent", name="own", file=None, module=str(arrays)))


def test_beside_another_detector_any_search_goes() -> None:
    config = configured("descent", name="pointpillars", scored_by=["onnx"])
    refuse_gradient_search(config)
    assert config.detector.weights_by_name() == {"pointpillars": None, "onnx": "mine.onnx"}


@pytest.mark.parametrize(
    ("detector", "says"),
    [
        ({"file": None}, r"file is null.*detector\.file=FILE\.onnx"),
        ({"weights": "a.safetensors"}, r"weights means nothing for detector=onnx"),
        ({"original": "onnx"}, r"original is onnx"),
        ({"original": "own"}, r"detector\.module=FILE\.py"),
        ({"name": "pointpillars"}, r"file means nothing without detector=onnx"),
    ],
)
def test_settings_that_do_not_go_together(detector: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        configured(**detector)


def compiled(folder: Path, bias: float, **more: Any) -> DetectorConfig:
    (folder / "own.py").write_text(OWN_SOURCE)
    file = write_model(folder / f"mine{bias}.onnx", bias)
    values: dict[str, Any] = {"name": "onnx", "scored_by": [], "other_weights": {}, "file": str(file), **more}
    return DetectorConfig(**values)


def test_the_files_bytes_are_what_a_task_is_known_by(tmp_path: Path) -> None:
    first, second = compiled(tmp_path, 0.0), compiled(tmp_path, 0.5)
    hashes = [detector_hash("onnx", path, None) for path in (first.file, second.file)]
    assert hashes[0] != hashes[1] == detector_hash("onnx", second.file, None)
    assert scoring_detectors(first) == {"onnx": first.file}
    Path(str(first.file)).write_bytes(b"nothing")
    with pytest.raises(InputError, match="it is no ONNX file"):
        scoring_detectors(first)
    Path(str(first.file)).unlink()
    with pytest.raises(InputError, match=r"mine0\.0\.onnx: no such file. Check detector\.file"):
        scoring_detectors(first)


def test_the_file_travels_to_workers(tmp_path: Path) -> None:
    file = str(compiled(tmp_path, 0.0).file)
    (found,) = named_files(AssetsSpec(scenes={}, detectors={"onnx": file}))
    assert Path(found.folder, *found.names) == Path(file)


def test_scores_are_held_against_the_original(tmp_path: Path) -> None:
    streets = StreetScenes("hdl64", count=2)
    original = {"original": "own", "module": str(tmp_path / "own.py")}
    message = compare_with_original(compiled(tmp_path, 0.0, **original), streets, streets.names())
    assert "scores are those of own within" in message and "in 2 scenes" in message
    with pytest.raises(
        InputError, match=r"mine0\.1\.onnx: its score differs from own's by 0\.02.* in street-test-hdl64"
    ):
        compare_with_original(compiled(tmp_path, 0.1, **original), streets, streets.names())
    assert "compared with no original" in compare_with_original(compiled(tmp_path, 0.1), streets, streets.names())


def test_frames_of_one_name_in_two_folders_are_both_compared(tmp_path: Path) -> None:
    for folder, ahead_m in (("near", 0.0), ("far", 30.0)):
        write_frame(tmp_path / folder)
        points = street() + np.array([ahead_m, 0.0, 0.0, 0.0], np.float32)
        points.astype("<f4").tofile(tmp_path / folder / "training" / "velodyne" / f"{NAME}.bin")
    config = compiled(tmp_path, 0.0, original="own", module=str(tmp_path / "own.py"))
    (tmp_path / "own.py").write_text(OWN_SOURCE.replace("/ 100 *", "/ (100 if points[:, 0].mean() < 15 else 50) *"))
    near, far = (KittiScenes(tmp_path / folder) for folder in ("near", "far"))
    assert near.names() == far.names()
    compare_with_original(config, near, near.names())
    with pytest.raises(InputError, match=f"its score differs from own's .* in {NAME}"):
        compare_with_original(config, far, far.names())
