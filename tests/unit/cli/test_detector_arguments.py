"""Words for the parts of a detector: foreign words are refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
from foreign_cases import CASES

from shift3d.cli.detector_arguments import detector_files
from shift3d.errors import InputError
from shift3d.suite.scoring import Scorer


def test_words_become_a_scorer(tmp_path: Path) -> None:
    config, weights = CASES["openpcdet-pointpillar"].saved(tmp_path)
    layout = detector_files("openpcdet", {"config": str(config), "intensity": "0.5"}, "gate").layout
    assert layout is not None and layout["inputs"]["constants"] == [0.5]
    scorer = Scorer("openpcdet", str(weights), None, layout)
    assert scorer.at("float32").name == "openpcdet"
    other = detector_files("openpcdet", {"config": str(config)}, "gate").layout
    assert scorer.digest != Scorer("openpcdet", str(weights), None, other).digest
    assert detector_files("sst", {"weights": "x"}, "gate") == ("x", None, None)


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("sst", {"config": "x"}, "config= means nothing for detector=sst"),
        ("mmdet3d", {}, "config= is missing"),
        ("mmdet3d", {"config": "absent.py", "intensity": "much"}, "intensity='much' is not a number"),
        ("mmdet3d", {"config": "absent.py", "sensor_height_m": "nan"}, "is not a number"),
        ("mmdet3d", {"config": "absent.py"}, "no such file"),
    ],
)
def test_words_that_do_not_belong(name: str, values: dict[str, str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        detector_files(name, values, "gate")


@pytest.mark.parametrize(
    ("name", "keys", "says"),
    [
        ("sst", ["module"], "module= means nothing for detector=sst"),
        ("own", ["module", "file"], "file= means nothing for detector=own"),
        ("onnx", ["file", "weights"], "weights= means nothing for detector=onnx"),
        ("onnx", ["file", "config"], "config= means nothing for detector=onnx"),
        ("own", ["weights"], "module= is missing. Give module=FILE.py"),
        ("onnx", [], "file= is missing. Give file=FILE.onnx"),
    ],
)
def test_files_that_do_not_belong(tmp_path: Path, name: str, keys: list[str], says: str) -> None:
    (tmp_path / "mine").touch()
    with pytest.raises(InputError, match=says):
        detector_files(name, dict.fromkeys(keys, str(tmp_path / "mine")), "gate")
