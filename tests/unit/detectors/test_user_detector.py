"""The user's own detector: the guide's file is valid, and an invalid file is refused in a line that names it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from shift3d.detectors.user_detector import UserDetector, load_user_detector
from shift3d.errors import InputError

GUIDE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "detectors.md"
SOURCE = re.search(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)[1]  # type: ignore[index]
HEAD = "import torch\nfrom torch import nn\n"
BOX = "torch.tensor([[1.0, 2.0, 0.8, 4.5, 1.9, 1.6, 0.0]])"


@pytest.fixture
def guides(tmp_path: Path) -> Path:
    path = tmp_path / "my_detector.py"
    path.write_text(SOURCE)
    return path


def points(count: int = 500) -> torch.Tensor:
    draw = torch.Generator().manual_seed(3)
    return torch.rand(count, 3, generator=draw) * torch.tensor([60.0, 60.0, 2.5]) - torch.tensor([30.0, 30.0, 0.0])


def test_the_guides_detector_takes_the_lines_that_it_promises(guides: Path) -> None:
    assert len([line for line in SOURCE.splitlines() if line.strip()]) <= 32
    detector = load_user_detector(guides, None)
    found = detector.proposals(points())
    assert found.boxes.shape == (10_000, 7) and found.logits.shape == (10_000,)
    assert found.anchor_index.tolist() == list(range(10_000))


def test_its_gradient_is_that_of_the_scores(guides: Path) -> None:
    detector = load_user_detector(guides, None, "float64")
    at = points(20).double().requires_grad_()
    weights = torch.rand(10_000, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda x: (detector.proposals(x).logits * weights).sum(), (at,), atol=1e-6)


def test_a_cluster_of_points_is_found(guides: Path) -> None:
    cluster = torch.rand(600, 3) * torch.tensor([4.0, 1.8, 1.5]) + torch.tensor([18.0, -6.0, 0.2])
    best = load_user_detector(guides, None).detect(cluster, score_threshold=0.5).boxes[0]
    assert abs(best[0] - 20.0) <= 2.0 and abs(best[1] + 5.1) <= 1.5


def written(path: Path, parts: str, logits: str) -> Path:
    """Write a detector's file. parts: of its module, made from weights. logits: of points, from these parts."""
    path.write_text(
        f"{HEAD}class Net(nn.Module):\n"
        "    def __init__(self, weights):\n"
        f"        super().__init__()\n        {parts}\n"
        f"    def forward(self, points):\n        return {BOX}, {logits}\n"
        "def load(weights):\n    return Net(weights)\n"
    )
    return path


def test_weights_are_handed_over_and_random_ones_are_the_same_everywhere(tmp_path: Path) -> None:
    given = "\n        if weights: self.load_state_dict(torch.load(weights, weights_only=True))"
    path = written(tmp_path / "mine.py", f"self.layer = nn.Linear(3, 1){given}", "self.layer(points.sum(0))")
    at = points()
    drawn = [load_user_detector(path, None).proposals(at).logits for _ in range(2)]
    assert torch.equal(drawn[0], drawn[1])
    torch.save({"layer.weight": torch.ones(1, 3), "layer.bias": torch.zeros(1)}, tmp_path / "mine.pt")
    torch.testing.assert_close(load_user_detector(path, tmp_path / "mine.pt").proposals(at).logits, at.sum()[None])


def test_a_module_that_computes_in_float64_keeps_its_numbers(tmp_path: Path) -> None:
    parts = "self.w = nn.Parameter(torch.ones(3, dtype=torch.float64))"
    path, at = written(tmp_path / "mine.py", parts, "(points.double() @ self.w).sum()[None]"), points()
    for precision in ("float32", "float64"):
        found = load_user_detector(path, None, precision).proposals(at).logits  # type: ignore[arg-type]
        torch.testing.assert_close(found.double(), at.double().sum()[None])


def test_a_function_is_a_detector_too(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        f"{HEAD}def score(points):\n    return {BOX}, points.sum()[None]\ndef load(weights): return score\n"
    )
    assert isinstance(load_user_detector(path, None), UserDetector)


def test_a_function_with_float32_weights_scores_at_every_precision(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        f"{HEAD}w = torch.full((3,), 0.5)\n"
        f"def load(weights): return lambda points: ({BOX}, (points.sum(0) @ w)[None])\n"
    )
    at = torch.ones(4, 3, dtype=torch.float64)
    for precision in ("float32", "bfloat16", "float64"):
        found = load_user_detector(path, None, precision).proposals(at)  # type: ignore[arg-type]
        assert found.logits.tolist() == [6.0]


@pytest.mark.parametrize("name", ["mine.py", "module.py", "linear.py"])
def test_an_error_names_the_line_of_the_users_file(name: str, tmp_path: Path) -> None:
    """torch/nn/modules holds a module.py and a linear.py, through which the error passes."""
    path = written(tmp_path / name, "self.layer = nn.Linear(4, 1)", "self.layer(points)")
    line = next(number for number, text in enumerate(path.read_text().splitlines(), 1) if "self.layer(points)" in text)
    with pytest.raises(InputError, match=rf"{name}, line {line}: RuntimeError"):
        load_user_detector(path, None)


def test_a_syntax_error_of_another_file_names_the_line_that_imports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "a_broken_library.py").write_text("\n" * 8 + "def broken(:\n")
    (tmp_path / "mine.py").write_text("import torch\nimport a_broken_library\n")
    with pytest.raises(InputError, match=r"mine\.py, line 2: SyntaxError.*a_broken_library\.py, line 9"):
        load_user_detector(tmp_path / "mine.py", None)


def test_a_file_that_changes_is_another_one(tmp_path: Path) -> None:
    """The file changes within a second and at the same length, so that compiled files would hide the change."""
    path = tmp_path / "mine.py"
    for factor in (2, 3):
        path.write_text(f"{HEAD}def load(weights): return lambda points: ({BOX}, {factor} * points.sum()[None])\n")
        at = torch.ones(1, 3)
        assert float(load_user_detector(path, None).proposals(at).logits) == 3.0 * factor
    assert not (tmp_path / "__pycache__").exists()


NUMPY = "import numpy as np"
NEAREST = """
import numpy as np

def detect(points):
    x = points.numpy()
    near = x[np.hypot(x[:, 0], x[:, 1]) < 10.0, :3]
    boxes = np.tile(np.float32([0, 0, 0.8, 4.5, 1.9, 1.6, 0]), (len(near), 1))
    boxes[:, :2] = near[:, :2]
    return boxes, np.float32(1.0 - np.hypot(near[:, 0], near[:, 1]) / 10.0)

def load(weights):
    return detect
"""


def test_numpy_arrays_are_boxes_and_scores_without_a_gradient(tmp_path: Path) -> None:
    """The number of boxes depends on the points, and a window takes the boxes inside it."""
    path, at = tmp_path / "mine.py", torch.tensor([[3.0, 4.0, 1.0], [0.5, 0.0, 1.0], [40.0, 0.0, 1.0]])
    path.write_text(NEAREST)
    detector = load_user_detector(path, None, "float64")
    found = detector.proposals(at.double().requires_grad_())
    assert not found.logits.requires_grad
    torch.testing.assert_close(found.boxes[:, :2], at[:2, :2])
    torch.testing.assert_close(torch.sigmoid(found.logits), torch.tensor([0.5, 0.95]).double())
    around = detector.proposals(at, detector.window_for((3.0, 4.0), 2.0))
    assert around.anchor_index.tolist() == [0]
    assert len(detector.proposals(at[2:]).logits) == 0 and len(detector.detect(at[2:]).scores) == 0
    assert detector.detect(at).scores.tolist() == pytest.approx([0.95, 0.5])


@pytest.mark.parametrize("answer", ["moved.sum()[None] / 1e6 - 1", "torch.sigmoid(moved.sum()[None]).numpy()"])
def test_points_that_a_model_moves_in_place_are_its_own(tmp_path: Path, answer: str) -> None:
    """Models often begin with the height of their sensor; the scene, and the next detector, keep their points."""
    path, at = tmp_path / "mine.py", points(3000)
    box = f"{BOX}.numpy()" if "numpy" in answer else BOX
    path.write_text(
        f"{HEAD}def detect(moved):\n    moved[:, 2] -= 1.7\n    return {box}, {answer}\n"
        "def load(weights):\n    return detect\n"
    )
    detector, before = load_user_detector(path, None), at.clone()
    with torch.no_grad():
        detector.proposals(at)
    assert torch.equal(at, before)


def test_the_guides_program_is_asked_for_boxes(tmp_path: Path) -> None:
    """The program returns one box at the first point, with the number of points over 10,000 as its score."""
    program, path = tmp_path / "detect", tmp_path / "mine.py"
    answer = "[*points[0], 4.5, 1.9, 1.6, 0.0, len(points) / 1e4]"
    program.write_text(
        f"#!{sys.executable}\nimport sys\nimport numpy as np\n"
        "points = np.frombuffer(sys.stdin.buffer.read(), dtype=np.float32).reshape(-1, 3)\n"
        f"sys.stdout.buffer.write(np.float32({answer}).tobytes())\n"
    )
    program.chmod(0o755)
    section = GUIDE.read_text().partition("### Without a gradient\n")[2]
    source = re.search(r"```python\n(.*?)```", section, re.DOTALL)[1]  # type: ignore[index]
    path.write_text(source.replace("/opt/perception/detect", str(program)))
    found = load_user_detector(path, None).detect(at := points(3000))
    assert found.scores.tolist() == pytest.approx([0.3])
    np.testing.assert_allclose(found.boxes[0, :3], at[0].numpy())
    program.write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(InputError, match=r"mine\.py, line 12: CalledProcessError.*exit status 3"):
        load_user_detector(path, None)


def body(answer: str, before: str = "") -> str:
    return f"{HEAD}{before}\ndef load(weights):\n    return lambda points: {answer}\n"


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("def load(weights)\n", r"mine\.py, line 1: SyntaxError"),
        ("import no_such_library\n", r"mine\.py, line 1: ModuleNotFoundError.*no_such_library.*Install the library"),
        ("x = 1\n", r"mine\.py: it has no function load"),
        ("def load(weights):\n    return 3\n", r"nothing that can be called"),
        ("def load(weights):\n    raise ValueError('no weights')\n", r"mine\.py, line 2: ValueError: no weights"),
        (body("points.sum()"), r"neither torch tensors \(boxes, logits\) nor numpy arrays \(boxes, scores\)"),
        (body("(np.ones((1, 6)), np.ones(1))", NUMPY), r"boxes \(1, 6\)"),
        (body("(np.ones((2, 7)), np.ones(1))", NUMPY), r"scores \(1,\)"),
        (body("(np.ones((1, 7)), np.full(1, 2.5))", NUMPY), r"scores reach from 2\.5 .*Return probabilities"),
        (body("(np.ones((1, 7)), np.full(1, np.nan))", NUMPY), r"NaN or infinity"),
        (body("(np.full((1, 7), 1e300), np.ones(1))", NUMPY), r"NaN or infinity"),
        (body("(np.ones((1, 7)), np.random.rand(1))", NUMPY), r"two calls with the same points differ"),
        (body("(np.ones((1, 7)), np.array(['a']))", NUMPY), r"mine\.py: ValueError"),
        (body("(np.ones((1, 7)), np.ones(1)) if len(points) > 1500 else None", NUMPY), r"for some points only"),
        (body(f"({BOX}[:, :6], points.sum()[None])"), r"boxes \(1, 6\)"),
        (body(f"({BOX}, points.sum())"), r"logits \(\)"),
        (body(f"({BOX} * 0, points.sum()[None])"), r"boxes without a size"),
        (body(f"({BOX}.double() * 1e300, points.sum()[None])"), r"NaN or infinity"),
        (body(f"({BOX}, exit(2))"), r"mine\.py, line 5: SystemExit: 2"),
        (body(f"({BOX}, points.sum()[None] / 0)"), r"NaN or infinity"),
        (body(f"({BOX}, points.detach().sum()[None])"), r"do not depend on the points differentiably"),
        (body(f"({BOX}, torch.rand(1) * points.sum()[None])"), r"two calls with the same points differ"),
        (body(f"({BOX}, (points * 0).sum()[None].sqrt())"), r"no finite gradient"),
        (body(f"({BOX}.expand(len(points), 7), points.sum(1))"), r"boxes \(0, 7\)"),
        (body(f"({BOX}, points.mean()[None])"), r"NaN or infinity in its answer, given no points"),
        (body(f"({BOX}, points.sum()[None].sigmoid())"), r"between 0 and 1\. Return them before the sigmoid"),
        (body(f"({BOX}, points @ torch.ones(4))"), r"mine\.py, line 5: RuntimeError"),
    ],
)
def test_what_is_no_detector_is_refused_in_one_line(tmp_path: Path, source: str, says: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(source)
    with pytest.raises(InputError, match=says) as caught:
        load_user_detector(path, None)
    assert caught.value.remedy and "\n" not in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_user_detector(tmp_path / "mine.py", None)


def test_equal_files_in_two_folders_are_two_modules(tmp_path: Path) -> None:
    text = (
        "from pathlib import Path\nimport torch\nW = float(Path(__file__).with_name('w').read_text())\n"
        "class Net(torch.nn.Module):\n    def forward(self, points):\n"
        "        return torch.ones(1, 7), points.sum()[None] * 0 + W\n"
        "def load(weights):\n    return Net()\n"
    )
    found = []
    for name, weight in (("a", "-1"), ("b", "3")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "w").write_text(weight)
        (tmp_path / name / "det.py").write_text(text)
        found.append(float(load_user_detector(tmp_path / name / "det.py", None).proposals(torch.zeros(4, 3)).logits[0]))
    assert found == [-1.0, 3.0]
