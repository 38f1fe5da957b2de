"""The auto-decoder training: it learns, it resumes to the same weights, it refuses another recipe's folder."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import pytest
import torch

from shift3d.errors import InputError
from shift3d.training.checkpoints import read_checkpoint, write_checkpoint
from shift3d.training.compute import choose_compute
from shift3d.training.sdf import loop
from shift3d.training.sdf import train as sdf
from shift3d.training.sdf_shapes import shape_samples

TINY = sdf.SdfRecipe(shapes=2, samples_a_shape=600, batch_a_shape=64, steps=6, seed=1, compute="float32")


@pytest.fixture(scope="module")
def shapes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shapes")
    shape_samples(TINY.shapes, TINY.samples_a_shape, TINY.seed, folder, 1)
    return folder


def prepared(folder: Path, shapes: Path) -> Path:
    folder.mkdir()
    (folder / "shapes").symlink_to(shapes)
    return folder


def test_training_that_was_interrupted_ends_in_the_same_weights(
    tmp_path: Path, shapes: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loop, "CURVE_STEPS", 2)
    whole = read_checkpoint(sdf.train_sdf(prepared(tmp_path / "whole", shapes), TINY, checkpoint_every=3))
    cut = prepared(tmp_path / "cut", shapes)
    write = loop.write_checkpoint

    def write_then_die(path: Path, state: dict[str, object]) -> None:
        write(path, state)
        raise KeyboardInterrupt

    with monkeypatch.context() as killed, pytest.raises(KeyboardInterrupt):
        killed.setattr(loop, "write_checkpoint", write_then_die)
        sdf.train_sdf(cut, TINY, checkpoint_every=3)
    resumed = read_checkpoint(sdf.train_sdf(cut, TINY, checkpoint_every=3))
    assert resumed["step"] == whole["step"] == 6
    assert resumed["losses"] == whole["losses"] and len(whole["losses"]) == 3, "each the mean of two steps"
    assert torch.equal(resumed["codes"], whole["codes"])
    assert all(torch.equal(resumed["decoder"][name], value) for name, value in whole["decoder"].items())


def test_loss_falls(shapes: Path) -> None:
    recipe = dataclasses.replace(TINY, steps=200, network_rate=3e-3)
    samples = shape_samples(TINY.shapes, TINY.samples_a_shape, TINY.seed, shapes, 1)
    run = sdf.SdfRun(recipe, samples, choose_compute("cpu"))
    losses = [run.advance() for _ in range(100)]
    assert sum(losses[-10:]) < 0.7 * sum(losses[:10])


def test_a_loss_that_is_no_number_ends_the_training(tmp_path: Path, shapes: Path) -> None:
    samples = shape_samples(TINY.shapes, TINY.samples_a_shape, TINY.seed, shapes, 1)
    samples.distances[1] = float("nan")  # as from a damaged mesh
    with pytest.raises(InputError, match=r"loss of step 1 is not finite"):
        sdf.train_sdf(tmp_path, TINY, samples=samples)


def test_folder_of_another_recipe_is_refused(tmp_path: Path, shapes: Path) -> None:
    out = prepared(tmp_path / "out", shapes)
    sdf.train_sdf(out, dataclasses.replace(TINY, steps=1))
    with pytest.raises(InputError, match=r"another recipe \(steps=1, not 2\)"):
        sdf.train_sdf(out, dataclasses.replace(TINY, steps=2))


def test_checkpoint_that_is_no_checkpoint_names_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.pt: no such checkpoint"):
        read_checkpoint(tmp_path / "none.pt")
    (tmp_path / "bad.pt").write_bytes(b"not a checkpoint")
    with pytest.raises(InputError, match=r"bad\.pt"):
        read_checkpoint(tmp_path / "bad.pt")
    write_checkpoint(tmp_path / "good.pt", {"step": 3, "x": torch.ones(2)})
    assert not list(tmp_path.glob(".*"))
    content = (tmp_path / "good.pt").read_bytes()
    for place in range(content.index(b"step") - 20, content.index(b"step") + 60):
        (tmp_path / "bad.pt").write_bytes(content[:place] + b"\xff" + content[place + 1 :])
        with contextlib.suppress(InputError):  # and no other error
            read_checkpoint(tmp_path / "bad.pt")
    again = read_checkpoint(tmp_path / "good.pt")
    assert again["step"] == 3
