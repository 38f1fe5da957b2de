"""A network on pillars as an ONNX graph from points (N, 3), any N, to every proposal's box and score."""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn

from shift3d.detectors.compiled.onnx_detector import require_packages
from shift3d.detectors.grid import full_window
from shift3d.detectors.models.anchor_heads import AnchorHeads
from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import PillarBackboneNet
from shift3d.detectors.names import COMPILED
from shift3d.errors import InputError

OPSET = 18
"""The first one whose ScatterElements can add and take the maximum."""


class PointsToScores(nn.Module):
    """The whole grid's proposals, with fixed shapes but for the number of points.

    Pillars are not grouped, as `grid.assign_pillars` groups them: every point is added to its cell of the dense grid,
    and what lies outside goes to one cell more, which is cut off. Sums are taken in the order of the points.

    Args: net: of pillars, as its `inference("float32")` gives it.
    """

    limits: Tensor

    def __init__(self, net: PillarBackboneNet) -> None:
        super().__init__()
        if isinstance(net.heads, AnchorHeads):  # a number of the graph, whose shape cannot follow a tensor's value
            size_m = net.heads.anchors.size_m
            del net.heads.anchor_size_m
            net.heads.anchor_size_m = size_m  # type: ignore[assignment]
        self.net = net
        self.cells = net.grid.num_x * net.grid.num_y
        grid = net.grid
        # As tensors: the exporter rounds float64 numbers to float32, and points near an edge would change their cell.
        limits = torch.tensor(
            (grid.x_min_m, grid.y_min_m, grid.z_min_m, grid.z_max_m, grid.cell_m), dtype=torch.float64
        )
        self.register_buffer("limits", limits, persistent=False)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """points: (N, 3) float32, network frame, metres. Returns boxes (A, 7) and scores (A,), float32.

        The score of a proposal that suppression is not given, of a centre that is no peak, is 0.
        """
        canvas = self._canvas(points).view(1, self.net.grid.num_y, self.net.grid.num_x, -1).permute(0, 3, 1, 2)
        features = self.net.backbone(canvas)
        heads = self.net.heads
        window, logits = full_window(self.net.grid), heads.logits(features)[0]
        boxes = heads.decode(heads.box_rows(features)[0], self.net.grid, window)
        scores, kept = torch.sigmoid(logits), heads.reported(logits, window)
        return boxes, scores if kept is None else torch.where(kept, scores, 0.0)

    def _canvas(self, points: Tensor) -> Tensor:
        """(cells, C), zero where no point is."""
        grid, exact = self.net.grid, points.double()  # cells in float64, as `grid.cells_of` takes them
        corner, low, high, edge = self.limits[:2], self.limits[2], self.limits[3], self.limits[4]
        place = torch.floor((exact[:, :2] - corner) / edge)
        column, line = place[:, 0], place[:, 1]
        inside = (column >= 0) & (column < grid.num_x) & (line >= 0) & (line < grid.num_y)
        inside = inside & (exact[:, 2] >= low) & (exact[:, 2] < high)
        cell = torch.where(inside, line * grid.num_x + column, float(self.cells)).long()
        points = torch.where(inside[:, None], points, 0.0)
        total = points.new_zeros(self.cells + 1, 3).scatter_reduce(0, cell[:, None].expand(-1, 3), points, "sum")
        count = points.new_zeros(self.cells + 1).scatter_reduce(0, cell, torch.ones_like(points[:, 0]), "sum")
        mean = total[cell] / count[cell][:, None]
        centre = corner + (place + 0.5) * edge
        decorated = torch.cat((points, points - mean, points[:, :2] - centre.to(points.dtype)), dim=1)
        features: Tensor = self.net.pillar_net.linear(decorated)  # type: ignore[attr-defined]
        # From zero: the maximum and the ReLU after it at once.
        canvas = features.new_zeros(self.cells + 1, features.shape[1])
        where = cell[:, None].expand(-1, features.shape[1])
        return canvas.scatter_reduce(0, where, features, "amax")[: self.cells]


def onnx_bytes(net: DetectorNet) -> bytes:
    """A network as the content of an ONNX file, which `onnx_detector.load_onnx` reads.

    Input `points` (N, 3) float32, network frame; outputs `boxes` (A, 7) and `scores` (A,), float32, one a proposal of
    the whole grid, before suppression.

    Raises: InputError for a network that is not on pillars, or a package that is missing.
    """
    if not isinstance(net, PillarBackboneNet):
        remedy = f"Export {' or '.join(COMPILED)}"
        raise InputError(f"{net.name} has windows of tokens, which have no ONNX export", "detector", remedy)
    require_packages("onnx", "onnxscript")
    module = PointsToScores(net.inference("float32")).eval()
    with _silence(), torch.no_grad():
        program = torch.onnx.export(
            module,
            (torch.rand(100, 3),),
            input_names=["points"],
            output_names=["boxes", "scores"],
            dynamic_shapes=({0: torch.export.Dim("N")},),
            custom_translation_table={torch.ops.prims.hypot.default: _hypot},
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    return _without_traces(program.model_proto)


def _hypot(x: Any, y: Any) -> Any:
    """The diagonal of anchors: ONNX has no operator for it."""
    from onnxscript import opset18 as op

    return op.Sqrt(op.Add(op.Mul(x, x), op.Mul(y, y)))


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """No word of the exporter's about itself; its errors are exceptions."""
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        log.setLevel(level)


def _without_traces(model: Any) -> bytes:
    """The model's bytes without what the exporter notes of this machine: paths of source files, stack traces."""
    for holder in (model, model.graph, *model.graph.node, *model.graph.value_info, *model.graph.initializer):
        holder.ClearField("doc_string")
        holder.ClearField("metadata_props")
    return bytes(model.SerializeToString(deterministic=True))
