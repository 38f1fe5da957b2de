"""Weights and checkpoints on a full disk: one clear error, and existing files stay."""

from __future__ import annotations

import resource
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch

from shift3d.detectors.models.weights import NETWORKS
from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, Decoder, save_decoder
from shift3d.store.atomic import disk_error
from shift3d.training import command
from shift3d.training.checkpoints import write_checkpoint
from shift3d.training.detector.recipe import Recipe
from shift3d.training.detector.train import export_weights

WRITERS: dict[str, Callable[[Path], None]] = {
    "checkpoint": lambda file: write_checkpoint(file, {"weights": torch.zeros(10_000)}),
    "decoder": lambda file: save_decoder(Decoder(Architecture()), file),
    "detector": lambda file: export_weights(NETWORKS["pointpillars"](), file, Recipe()),
}


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No file of this process may exceed 1 kB: the write itself fails, as on a full disk."""
    # Python 3.11 would leave truncated .pyc files of modules imported meanwhile, and fail on them later.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1024, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("name", WRITERS)
def test_what_was_there_stays(name: str, tmp_path: Path, full: None) -> None:
    file = tmp_path / "weights"
    file.write_bytes(b"older")
    with pytest.raises(InputError, match="the file would pass the size limit") as refused:
        WRITERS[name](file)
    assert refused.value.where == str(file)
    assert [path.name for path in tmp_path.iterdir()] == ["weights"] and file.read_bytes() == b"older"


def test_what_a_library_is_refused_is_a_line_too(tmp_path: Path, full: None) -> None:
    with pytest.raises(OSError) as refused:
        (tmp_path / "picture.png").write_bytes(bytes(5000))
    problem = disk_error(refused.value)
    assert problem is not None and problem.what == "the file would pass the size limit"
    assert disk_error(FileNotFoundError(2, "none")) is None, "a defect of ours keeps its traceback"


def test_weights_that_cannot_be_written_are_known_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "WEIGHTS_FOLDER", Path("/proc/nowhere"))
    for model in ("sdf", "centerpoint"):
        with pytest.raises(InputError, match=r"/proc/nowhere.*out=DIR"):
            command.train(model, command.TrainOptions(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
