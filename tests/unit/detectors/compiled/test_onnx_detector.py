"""An ONNX file as a detector: its answers, and one-line refusals of unusable files."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper
from onnx_files import BOXES, graph_nodes, model, spread, write_model

from shift3d.detectors.compiled.onnx_detector import load_onnx
from shift3d.errors import InputError


def points(count: int = 500, seed: int = 3) -> torch.Tensor:
    draw = torch.Generator().manual_seed(seed)
    return torch.rand(count, 3, generator=draw) * torch.tensor([60.0, 60.0, 2.5]) - torch.tensor([30.0, 30.0, 0.0])


@pytest.mark.parametrize("count", [1, 500, 2001])
def test_it_answers_with_the_graphs_boxes_and_scores(tmp_path: Path, count: int) -> None:
    detector = load_onnx(write_model(tmp_path / "mine.onnx"))
    found = detector.proposals(points(count))
    np.testing.assert_array_equal(found.boxes.numpy(), BOXES)
    np.testing.assert_allclose(torch.sigmoid(found.logits).numpy(), spread(points(count).numpy()), atol=1e-6)
    assert found.anchor_index.tolist() == [0, 1] and not found.logits.requires_grad


def test_the_gradient_of_the_points_is_no_matter(tmp_path: Path) -> None:
    requested = points().double().requires_grad_()
    assert not load_onnx(write_model(tmp_path / "mine.onnx")).proposals(requested).logits.requires_grad


def test_saturated_scores_have_finite_logits(tmp_path: Path) -> None:
    for bias in (-1e4, 1e4):
        found = load_onnx(write_model(tmp_path / "mine.onnx", bias)).detect(points())
        assert found.scores.tolist() == pytest.approx([1.0, 1.0] if bias > 0 else [])
        logits = load_onnx(write_model(tmp_path / "mine.onnx", bias)).proposals(points()).logits
        assert bool(torch.isfinite(logits).all()) and bool((logits.sign() == np.sign(bias)).all())


def test_after_suppression_there_may_be_no_box(tmp_path: Path) -> None:
    """Only boxes of scores above one half remain: their number depends on the points."""
    nodes = [
        *(node for node in graph_nodes() if node.op_type not in ("Sigmoid", "Identity")),
        helper.make_node("Sigmoid", ["logits"], ["all"]),
        helper.make_node("Greater", ["all", "half"], ["kept"]),
        helper.make_node("Compress", ["all", "kept"], ["scores"], axis=0),
        helper.make_node("Compress", ["constant", "kept"], ["boxes"], axis=0),
    ]
    file = model(-1.0, nodes)
    file.graph.initializer.append(onnx.numpy_helper.from_array(np.array(0.5, np.float32), "half"))
    onnx.save_model(file, tmp_path / "mine.onnx")
    detector = load_onnx(tmp_path / "mine.onnx")
    ahead = points() + torch.tensor([400.0, 0.0, 0.0])
    assert [len(detector.proposals(cloud).logits) for cloud in (points(), ahead)] == [0, 1]
    assert len(detector.detect(points()).scores) == 0


def test_a_window_holds_the_boxes_whose_centres_lie_in_it(tmp_path: Path) -> None:
    detector = load_onnx(write_model(tmp_path / "mine.onnx"))
    for (x, y), expected in ((BOXES[0, :2], [0]), (BOXES[1, :2], [1]), ((0.0, 0.0), [])):
        found = detector.proposals(points(), detector.window_for((float(x), float(y)), 5.0))
        assert found.anchor_index.tolist() == expected
        np.testing.assert_array_equal(found.boxes.numpy(), BOXES[expected])
    assert len(detector.proposals(points(), detector.window_for((0.0, 0.0), 25.0)).logits) == 2


def custom() -> list[object]:
    return [*graph_nodes()[:-2], helper.make_node("Magic", ["logits"], ["scores"], domain="mine"), graph_nodes()[-1]]


def random_scores() -> list[object]:
    drawn = helper.make_node("RandomUniformLike", ["logits"], ["scores"], dtype=TensorProto.FLOAT)
    return [*graph_nodes()[:-2], drawn, graph_nodes()[-1]]


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"nodes": custom()}, r"ONNX Runtime does not take it: .*Magic"),
        ({"nodes": random_scores()}, r"two calls with the same points differ"),
        ({"more_inputs": ("intensity",)}, r"it has the inputs \['points', 'intensity'\], not the points alone"),
        ({"columns": 4}, r"its input points is tensor\(float\) \['N', 4\], not tensor\(float\) \(N, 3\)"),
        ({"rows": 1000}, r"its input points is tensor\(float\) \[1000, 3\]"),
        ({"dtype": TensorProto.INT64}, r"ONNX Runtime does not take it|tensor\(int64\)"),
        ({"outputs": ("boxes",)}, r"its outputs are \{'boxes': 'tensor\(float\)'\}"),
        ({"outputs": ("boxes", "logits")}, r"its outputs are .*'logits'"),
        ({"boxes": BOXES[:, :6]}, r"boxes \(2, 6\) and scores \(2,\)"),
        ({"boxes": BOXES[:1]}, r"boxes \(1, 7\) and scores \(2,\)"),
        ({"boxes": BOXES * 0}, r"boxes without a size"),
        ({"boxes": BOXES * np.float32("nan")}, r"NaN or infinity"),
        ({"bias": float("nan")}, r"NaN or infinity"),
    ],
)
def test_what_is_no_detector_is_refused_in_one_line(tmp_path: Path, parts: dict[str, object], says: str) -> None:
    path = write_model(tmp_path / "mine.onnx", **parts)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=says) as caught:
        load_onnx(path)
    assert "mine.onnx" in str(caught.value) and caught.value.remedy and "\n" not in str(caught.value)


def test_sparse_outputs_are_refused(tmp_path: Path) -> None:
    """ONNX Runtime calls them tensor(float) until it answers with them."""
    file = model()
    values = [
        onnx.numpy_helper.from_array(part, name) for part, name in ((BOXES.ravel(), "boxes"), (np.arange(14), ""))
    ]
    file.graph.sparse_initializer.append(helper.make_sparse_tensor(*values, [2, 7]))
    file.graph.node.remove(next(node for node in file.graph.node if list(node.output) == ["boxes"]))
    onnx.save_model(file, tmp_path / "mine.onnx")
    with pytest.raises(InputError, match=r"mine\.onnx: boxes or scores are sparse"):
        load_onnx(tmp_path / "mine.onnx")


def test_scores_are_no_logits(tmp_path: Path) -> None:
    nodes = [*graph_nodes()[:-2], helper.make_node("Identity", ["logits"], ["scores"]), graph_nodes()[-1]]
    with pytest.raises(InputError, match=r"scores reach from .* not within \[0, 1\]. Put a Sigmoid"):
        load_onnx(write_model(tmp_path / "mine.onnx", 3.0, nodes=nodes))


@pytest.mark.parametrize("content", [b"", b"not a model", b"PK\x03\x04" * 300, bytes(2000)])
def test_other_files_are_no_onnx(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "mine.onnx"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"mine\.onnx: it is no ONNX file"):
        load_onnx(path)


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = write_model(tmp_path / "mine.onnx")
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"mine\.onnx: "):
        load_onnx(path)


def test_it_is_tried_once_a_machine_and_again_where_the_note_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A note belongs to the file's content, wherever the file is; a refused file leaves none."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    run, passes = onnxruntime.InferenceSession.run, []
    monkeypatch.setattr(onnxruntime.InferenceSession, "run", lambda *given: (passes.append(1), run(*given))[1])
    for _ in range(2):
        with pytest.raises(InputError, match="two calls with the same points differ"):
            load_onnx(write_model(tmp_path / "random.onnx", nodes=random_scores()))
    assert len(passes) == 4
    load_onnx(write_model(tmp_path / "mine.onnx"))
    assert len(passes) == 7
    load_onnx(write_model(tmp_path / "copy.onnx"))
    assert len(passes) == 7
    load_onnx(write_model(tmp_path / "mine.onnx", 0.5))
    assert len(passes) == 10, "another content"
    shutil.rmtree(tmp_path / "cache")
    load_onnx(tmp_path / "copy.onnx")
    assert len(passes) == 13


@pytest.mark.parametrize("there", [True, False])
def test_data_in_another_file_is_refused_whether_it_is_there_or_not(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "mine.onnx"
    onnx.save_model(model(), path, save_as_external_data=True, location="mine.data", size_threshold=0)
    if not there:
        (tmp_path / "mine.data").unlink()
    with pytest.raises(InputError, match=r"tensors are in another file.*save_as_external_data=False"):
        load_onnx(path)


@pytest.mark.parametrize("kind", ["function", "sparse tensor"])
def test_data_in_another_file_is_refused_wherever_the_file_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """ONNX Runtime reads such data from the working directory, so that equal files would give other boxes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "boxes.data").write_bytes(BOXES.tobytes())
    outside = TensorProto(name="outside", data_type=TensorProto.FLOAT, dims=BOXES.shape)
    outside.data_location = TensorProto.EXTERNAL
    outside.external_data.add(key="location", value="boxes.data")
    if kind == "sparse tensor":
        outside.dims[:] = [BOXES.size]
        places = helper.make_tensor("places", TensorProto.INT64, [BOXES.size], range(BOXES.size))
        changed = model(nodes=[*graph_nodes()[:-1], helper.make_node("Identity", ["outside"], ["boxes"])])
        changed.graph.sparse_initializer.append(helper.make_sparse_tensor(outside, places, BOXES.shape))
    else:
        constant, versions = helper.make_node("Constant", [], ["found"], value=outside), [helper.make_opsetid("", 18)]
        changed = model(nodes=[*graph_nodes()[:-1], helper.make_node("Boxes", [], ["boxes"], domain="mine")])
        changed.functions.append(helper.make_function("mine", "Boxes", [], ["found"], [constant], versions))
    onnx.save_model(changed, tmp_path / "mine.onnx")
    with pytest.raises(InputError, match=r"1 of its tensors are in another file"):
        load_onnx(tmp_path / "mine.onnx")


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_onnx(tmp_path / "mine.onnx")


def test_a_missing_package_is_named_with_its_extra(tmp_path: Path) -> None:
    """The test runs a process whose import of onnxruntime fails as if it were not installed."""
    code = (
        "import sys, pathlib, importlib.abc\n"
        "class Gone(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name == 'onnxruntime': raise ModuleNotFoundError(name)\n"
        "import importlib.util; found = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name == 'onnxruntime' else found(name, *rest)\n"
        "from shift3d.detectors.compiled.onnx_detector import load_onnx\n"
        f"load_onnx(pathlib.Path({str(write_model(tmp_path / 'mine.onnx'))!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "the package onnxruntime is not installed. Run pip install 'shift3d[onnx]'" in done.stderr
