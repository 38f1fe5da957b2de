"""Input that a gate cannot use gives one line on stderr and exit code 2; worse weights give 6."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from onnx_files import write_model
from safetensors.torch import save_file
from suites_by_hand import write_detector, write_suite

from shift3d.cli.main import main
from shift3d.detectors.models.weights import NETWORKS
from shift3d.suite.frozen import manifest_bytes


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write_suite(tmp_path / "suite", scored_by="own")
    return tmp_path


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["gate", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("shift3d gate: ") and error.count("\n") == 1
    assert not Path("outputs").exists(), "nothing is half-written"
    return error


def test_exit_codes(folder: Path) -> None:
    module, weights = write_detector(folder, -9.0)
    assert main(["gate", "suite=suite", "detector=own", f"module={module}", f"weights={weights}", "mlflow=none"]) == 6
    module, weights = write_detector(folder, 9.0)
    assert (
        main(
            [
                "gate",
                "suite=suite",
                "detector=own",
                f"module={module}",
                f"weights={weights}",
                "accept=true",
                "mlflow=none",
            ]
        )
        == 0
    )
    assert (folder / "suite/releases/00000001.parquet").is_file()
    assert len(list((folder / "outputs/gate").iterdir())) == 2


def test_an_onnx_file(folder: Path) -> None:
    """The file's next release, which scores less where the suite's objects are, is compared with the file."""
    boxes = np.array([[10.0, 10.0, 0.8, 4.5, 1.9, 1.6, 0.0], [20.0, 10.0, 0.8, 4.5, 1.9, 1.6, 0.0]], np.float32)
    files = [write_model(folder / f"{bias:g}.onnx", bias, boxes=boxes) for bias in (2.0, -2.0)]
    words = ["gate", "suite=suite", "detector=onnx", "name=deployed", "mlflow=none"]
    assert main([*words, f"file={files[0]}", "accept=true"]) == 0
    assert main([*words, f"file={files[0]}"]) == 0
    assert main([*words, f"file={files[1]}"]) == 6


def test_another_module_is_no_release_of_the_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its name is its file's. A name without releases is refused if others have releases, unless given explicitly."""
    module, _ = write_detector(folder)
    other = shutil.copy(module, folder / "other.py")
    assert main(["gate", "suite=suite", "detector=own", f"module={module}", "accept=anyway", "mlflow=none"]) == 6
    shutil.rmtree("outputs")
    capsys.readouterr()
    words = ["suite=suite", "detector=own", f"module={other}", "accept=true", "mlflow=none"]
    error = refused(words, capsys)
    assert "has releases of detector, but none of other. Give name=detector for its next release" in error
    assert main(["gate", *words, "name=other"]) == 0
    assert "accepted as release 2, the first of own:other\n" in capsys.readouterr().out
    assert main(["gate", *words]) == 0, "a name that has releases need not be given again"


def test_releases_that_cannot_be_written_are_refused_before_anything_is_scored(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    module, _ = write_detector(folder, 9.0)
    words = ["suite=suite", "detector=own", f"module={module}", "mlflow=none", "accept=true"]
    (folder / "file").write_bytes(b"")
    assert "Choose another folder with releases=DIR" in refused([*words, "releases=file/releases"], capsys)


def test_weights_of_another_shape(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = {name: value.clone() for name, value in NETWORKS["pointpillars"]().state_dict().items()}
    state["heads.classes.bias"] = torch.zeros(3)
    save_file(state, folder / "other.safetensors")
    error = refused(["suite=suite", "detector=pointpillars", "weights=other.safetensors"], capsys)
    assert "other.safetensors: tensor heads.classes.bias has shape (3,), the network has" in error
    assert "no weights" in refused(["suite=suite", "detector=pointpillars", "weights=gone.safetensors"], capsys)


def test_a_changed_suite_and_a_missing_scene(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    module, _ = write_detector(folder)
    words = ["suite=suite", "detector=own", f"module={module}"]
    scene = next((folder / "suite" / "backgrounds").iterdir())
    scene.write_bytes(scene.read_bytes()[:-4] + b"PAR2")
    assert f"{scene.name}: was changed after the suite was frozen" in refused(words, capsys)
    scene.unlink()
    assert f"{scene.name}: is missing" in refused(words, capsys)
    manifest = json.loads((folder / "suite" / "suite.json").read_bytes())
    (folder / "suite" / "suite.json").write_bytes(manifest_bytes({**manifest, "version": 0}))
    assert "version 0; this program reads version 1" in refused(words, capsys)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["detector=own"], "suite= is missing"),
        (["suite=suite"], "detector= is missing"),
        (["suite=nowhere", "detector=own"], "no such suite"),
        (["suite=suite", "detector=yolo"], "detector='yolo' is unknown"),
        (["suite=suite", "detector=own"], "module= is missing. Give module=FILE.py"),
        (["suite=suite", "detector=own", "level=2"], "level='2' is not in"),
        (["suite=suite", "detector=own", "accept=yes"], "accept='yes' is unknown"),
        (["suite=suite", "detector=own", "workers=0"], "workers='0'"),
    ],
)
def test_bad_words(words: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert message in refused(words, capsys)
