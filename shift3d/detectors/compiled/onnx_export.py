"""Export of a pillar network as an ONNX graph from points (N, 3), any N, to box and score of every proposal."""

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
from shift3d.detectors.names import ONNX_EXPORTABLE
from shift3d.errors import InputError

OPSET = 18
"""First ONNX opset whose ScatterElements supports sum and maximum."""


class PointsToScores(nn.Module):
    """Module that computes boxes and scores of the whole grid; only the number of points has a dynamic shape.

    Points are not grouped as in `grid.assign_pillars`: each point is scattered to its cell of the dense grid. Points
    outside go to an extra cell, which is cut off. Sums are taken in the order of the points.

    Args: net: pillar network, as returned by its `inference("float32")`.
    """

    limits: Tensor

    def __init__(self, net: PillarBackboneNet) -> None:
        super().__init__()
        if isinstance(net.heads, AnchorHeads):  # a constant: shapes in the graph cannot depend on a tensor's value
            size_m = net.heads.anchors.size_m
            del net.heads.anchor_size_m
            net.heads.anchor_size_m = size_m  # type: ignore[assignment]
        self.net = net
        self.cells = net.grid.num_x * net.grid.num_y
        grid = net.grid
        # A tensor, because the exporter rounds Python floats to float32: points near an edge would change their cell.
        limits = torch.tensor(
            (grid.x_min_m, grid.y_min_m, grid.z_min_m, grid.z_max_m, grid.cell_m), dtype=torch.float64
        )
        self.register_buffer("limits", limits, persistent=False)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Compute boxes (A, 7) and scores (A,), float32, from points (N, 3) float32, network frame, metres.

        Proposals that do not enter suppression (cells that are no peak of the heat map) get the score 0.
        """
        canvas = self._canvas(points).view(1, self.net.grid.num_y, self.net.grid.num_x, -1).permute(0, 3, 1, 2)
        features = self.net.backbone(canvas)
        heads = self.net.heads
        window, logits = full_window(self.net.grid), heads.logits(features)[0]
        boxes = heads.decode(heads.box_rows(features)[0], self.net.grid, window)
        scores, kept = torch.sigmoid(logits), heads.reported(logits, window)
        return boxes, scores if kept is None else torch.where(kept, scores, 0.0)

    def _canvas(self, points: Tensor) -> Tensor:
        """Compute pillar features (cells, C), zero in cells without points."""
        grid, exact = self.net.grid, points.double()  # cells in float64, as in `grid.cells_of`
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
        # The maximum starts at zero, which includes the ReLU.
        canvas = features.new_zeros(self.cells + 1, features.shape[1])
        where = cell[:, None].expand(-1, features.shape[1])
        return canvas.scatter_reduce(0, where, features, "amax")[: self.cells]


def onnx_bytes(net: DetectorNet) -> bytes:
    """Export a network to the content of an ONNX file, which `onnx_detector.load_onnx` reads.

    Input `points` (N, 3) float32, network frame; outputs `boxes` (A, 7) and `scores` (A,), float32, one per proposal of
    the whole grid, before suppression.

    Raises: InputError if the network is not a pillar network, or if a package is missing.
    """
    if not isinstance(net, PillarBackboneNet):
        remedy = f"Export {' or '.join(ONNX_EXPORTABLE)}"
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
    """Compute hypot (the diagonal of anchors) from other operators: ONNX has none for it."""
    from onnxscript import opset18 as op

    return op.Sqrt(op.Add(op.Mul(x, x), op.Mul(y, y)))


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Suppress log lines and warnings of the exporter; it raises errors as exceptions."""
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
    """Serialize the model without the exporter's traces of the machine: paths of source files, stack traces."""
    for holder in (model, model.graph, *model.graph.node, *model.graph.value_info, *model.graph.initializer):
        holder.ClearField("doc_string")
        holder.ClearField("metadata_props")
    return bytes(model.SerializeToString(deterministic=True))
