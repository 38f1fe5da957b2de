"""Foreign checkpoints give the results of their codebases, and fulfil the detector's contract."""

from __future__ import annotations

from math import pi
from pathlib import Path

import pytest
import torch
from foreign_cases import CASES, Case, scene

from shift3d.detectors.foreign.detector import ForeignDetector
from shift3d.detectors.incremental.inference import incremental_inference


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture(scope="module")
def detector(case: Case, tmp_path_factory: pytest.TempPathFactory) -> ForeignDetector:
    return case.detector(tmp_path_factory.mktemp(case.name))


def source_in_float32_weights(case: Case):  # type: ignore[no-untyped-def]
    """Return the source with the checkpoint's weights, in float64 arithmetic."""
    source = case.source()
    source.model.float().double()
    return source


def test_it_computes_what_its_codebase_computes(case: Case, detector: ForeignDetector) -> None:
    points = scene(case)
    ours = points.clone().requires_grad_()
    found = detector.proposals(ours)
    theirs = points.clone().requires_grad_()
    boxes, logits = source_in_float32_weights(case).answer(case.to_model(theirs))
    boxes = case.from_model(boxes)
    assert float(logits.detach().std()) > 0.1
    torch.testing.assert_close(found.logits, logits, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(found.boxes[:, :6].double(), boxes[:, :6], rtol=1e-5, atol=1e-5)
    turned = torch.remainder(found.boxes[:, 6].double() - boxes[:, 6] + pi, 2 * pi) - pi
    assert float(turned.abs().max()) < 1e-5
    weights = torch.rand(len(logits), generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    (gradient,) = torch.autograd.grad((found.logits * weights).sum(), ours)
    (wanted,) = torch.autograd.grad((logits * weights).sum(), theirs)
    assert float(wanted.abs().max()) > 1e-3
    torch.testing.assert_close(gradient, wanted, rtol=1e-8, atol=1e-8)


def test_a_window_is_the_whole_scene_there(case: Case, detector: ForeignDetector) -> None:
    points = scene(case)
    full = detector.proposals(points)
    for centre in ((3.0, 1.0), (6.0, -5.0), (0.2, 0.2)):
        window = detector.window_for(centre, 1.0)
        part = detector.proposals(points, window)
        assert torch.equal(full.boxes[part.anchor_index][:, :6], part.boxes[:, :6])
        torch.testing.assert_close(full.logits[part.anchor_index], part.logits, rtol=1e-11, atol=1e-11)


def test_a_window_holds_every_anchor_near(case: Case, detector: ForeignDetector) -> None:
    layout = detector.layout
    if layout.head.kind != "anchors":
        pytest.skip("cells stand where they are")
    window = detector.window_for((6.0, -3.0), 1.0)
    kept = set(detector.proposals(scene(case), window).anchor_index.tolist())
    anchors = detector._inner._net.heads.anchor_rows(detector._inner._net.head_grid, _whole(detector))  # type: ignore[operator]
    centre = torch.tensor([3.0, 6.0] if case.turned else [6.0, -3.0])
    near = (anchors[:, :2] - centre).abs().amax(dim=1) <= 1.0
    assert near.any() and set(torch.nonzero(near).flatten().tolist()) <= kept


def _whole(detector: ForeignDetector):  # type: ignore[no-untyped-def]
    from shift3d.detectors.grid import full_window

    return full_window(detector._inner._net.head_grid)


def test_frame_by_frame_it_gives_what_it_gives_afresh(case: Case, detector: ForeignDetector) -> None:
    points = scene(case)
    window = detector.window_for((3.0, 1.0), 2.0)
    incremental = incremental_inference(detector, window)
    for shift in (0.0, 0.3, -0.2):
        moved = points.clone()
        moved[-25:, 1] += shift
        moved.requires_grad_()
        found, plain = incremental.proposals(moved, window), detector.proposals(moved, window)
        torch.testing.assert_close(found.logits, plain.logits, rtol=1e-10, atol=1e-10)
        torch.testing.assert_close(found.boxes, plain.boxes)
        gradients = [torch.autograd.grad(part.logits.square().sum(), moved)[0] for part in (found, plain)]
        torch.testing.assert_close(*gradients, rtol=1e-9, atol=1e-9)


def test_the_order_of_points_changes_no_bit(case: Case, detector: ForeignDetector) -> None:
    points = scene(case)
    order = torch.randperm(len(points), generator=torch.Generator().manual_seed(1))
    first, second = detector.proposals(points), detector.proposals(points[order])
    assert torch.equal(first.logits, second.logits) and torch.equal(first.boxes, second.boxes)


def test_no_points_and_points_elsewhere_are_scenes(case: Case, detector: ForeignDetector) -> None:
    none = detector.proposals(torch.zeros(0, 3))
    far = detector.proposals(torch.tensor([[500.0, 0.0, 1.0], [float("nan"), 0.0, 0.0]]))
    assert torch.equal(none.logits, far.logits) and bool(torch.isfinite(none.boxes).all())


@pytest.mark.parametrize("name", ["openpcdet-pointpillar", "mmdet3d-centerpoint"])
def test_lower_precisions_are_near(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    points, exact = scene(case), case.detector(tmp_path).proposals(scene(case)).logits
    single = case.detector(tmp_path, "float32").proposals(points.float()).logits
    rough = case.detector(tmp_path, "bfloat16").proposals(points.float()).logits
    assert float((single - exact).abs().max()) < 1e-4 * float(exact.abs().max())
    assert float((rough - exact).abs().max()) < 0.1 * float(exact.abs().max())


def test_a_full_pillar_keeps_every_point_and_no_zeros(tmp_path: Path) -> None:
    """The pillar has more points than the source's slots: its features are those of all its points."""
    case = CASES["openpcdet-pointpillar"]
    detector = case.detector(tmp_path)
    crowd = torch.rand(40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 0.39
    crowd += torch.tensor([4.0, 1.6, 0.5])
    source = source_in_float32_weights(case)
    object.__setattr__(source, "pillars", source.pillars.__class__(**{**vars(source.pillars), "cap": 40}))
    _, logits = source.answer(case.to_model(crowd))
    torch.testing.assert_close(detector.proposals(crowd).logits, logits, rtol=1e-9, atol=1e-9)


def test_its_own_suppression_is_its_default(tmp_path: Path) -> None:
    case = CASES["openpcdet-pointpillar"]
    detector, points = case.detector(tmp_path), scene(case)
    own = detector.detect(points, score_threshold=0.01)
    assert len(own.scores) and torch.equal(
        torch.from_numpy(own.boxes), torch.from_numpy(detector.detect(points, None, 0.01, 0.01).boxes)
    )
    assert len(detector.detect(points, None, 0.01, 0.7).scores) > len(own.scores)
