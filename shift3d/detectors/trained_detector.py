"""Trained network behind the Detector interface: exact windows, gradients to the points, boxes."""

from __future__ import annotations

from math import ceil, floor, isfinite

import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.grid import full_window
from shift3d.detectors.incremental.inference import IncrementalInference, UncachedInference
from shift3d.detectors.incremental.pillars import IncrementalPillars
from shift3d.detectors.incremental.sparse_backbone import SparseBackbone
from shift3d.detectors.incremental.tokens import IncrementalTokens
from shift3d.detectors.models.network import DetectorNet, Precision, precision_dtypes, proposal_indices
from shift3d.detectors.models.pillar_detectors import PillarBackboneNet
from shift3d.detectors.models.sst import SstNet
from shift3d.detectors.nms import NmsDetector
from shift3d.errors import InputError


class TrainedDetector(NmsDetector):
    """Trained network for inference on the CPU.

    precision: "float32" (default); "bfloat16" computes the large matrix products with half the bytes (an approximation:
    its error is measured where it is offered); "float64" is the reference. Points (N, 3) are in the network frame and
    are converted to the dtype of the precision.
    """

    def __init__(self, net: DetectorNet, precision: Precision = "float32") -> None:
        self.name = net.name
        self.precision = precision
        self.grid = net.grid
        self._dtype = precision_dtypes(precision)[0]
        self._net = net.inference(precision)
        self._cells: SparseBackbone | None = None  # made by the first call of `incremental` that needs it

    def window_for(self, centre_xy: tuple[float, float], radius_m: float) -> BevWindow:
        """Return the smallest window whose proposals with anchor centres within radius_m equal the full scene's.

        centre_xy: metres, network frame. The core is the bounding square of the disc, cut at the border of the grid.
        The window adds the receptive field. The network rounds both (PointPillars: to multiples of its stride).

        Raises: InputError if the disc is not finite or lies outside the grid. Source: our choice, the paper is silent.
        """
        if not all(isfinite(value) for value in (*centre_xy, radius_m)):
            raise InputError(f"no disc of {radius_m:g} m around {centre_xy}", where="detector window")
        grid, radius = self.grid, radius_m / self.grid.cell_m
        x = self._span((centre_xy[0] - grid.x_min_m) / grid.cell_m, radius, grid.num_x)
        y = self._span((centre_xy[1] - grid.y_min_m) / grid.cell_m, radius, grid.num_y)
        if x is None or y is None:
            what = f"no detector cell within {radius_m:g} m of ({centre_xy[0]:g}, {centre_xy[1]:g})"
            raise InputError(what, where="detector window", remedy="Choose a centre inside the detector's range")
        return BevWindow(*(part for pair in zip(x, y) for part in pair))

    def _span(self, centre: float, radius: float, cells: int) -> tuple[int, int, int, int] | None:
        low, high = max(0, floor(centre - radius)), min(cells, ceil(centre + radius))
        if low >= high:
            return None
        core_low, core_high = self._net.core_span(low, high, cells)
        outer_low, outer_high = self._net.outer_span(core_low, core_high, cells)
        return outer_low, outer_high - outer_low, core_low, core_high - core_low

    def proposals(self, points: Tensor, window: BevWindow | None = None) -> Proposals:
        """Score every proposal of the window's core, or of the whole grid if window is None.

        points: (N, 3), network frame, metres; points out of range are ignored, N = 0 is a valid scene. Differentiable
        w.r.t. points, through the logits; boxes are detached. Deterministic bit for bit, also under permutation of the
        points, for a fixed number of threads.
        """
        if points.ndim != 2 or points.shape[1] != 3:
            raise InputError(f"points have shape {tuple(points.shape)}, not (N, 3)", where="detector input")
        window = window or full_window(self.grid)
        return self._answer(self._net.features([points.to(self._dtype)], [window]), window)

    def _answer(self, features: Tensor, window: BevWindow) -> Proposals:
        """Compute proposals from the features (1, C, h, w) of a window's core."""
        logits = self._net.heads.logits(features)[0].to(self._dtype)
        with torch.no_grad():
            rows = self._net.heads.box_rows(features.detach())
        return self._proposals(logits, rows[0].to(self._dtype), window)

    def _proposals(self, logits: Tensor, rows: Tensor, window: BevWindow) -> Proposals:
        """Compute proposals from class logits (A,) and box layer outputs (cells, R) of a window's core."""
        heads, grid, window = self._net.heads, self._net.head_grid, self._net.head_window(window)
        with torch.no_grad():
            boxes, reported = heads.decode(rows, grid, window), heads.reported(logits, window)
        return Proposals(boxes.float(), logits, proposal_indices(heads.per_cell, grid, window), reported)

    def incremental(self, window: BevWindow) -> IncrementalInference:
        """Return incremental inference in a window: later frames of a scene cost only what changed between frames."""
        net = self._net
        if isinstance(net, SstNet):
            return IncrementalTokens(net, window, self._dtype, self.proposals, self._answer)
        if not (
            isinstance(net, PillarBackboneNet)
            and net.supports_incremental
            and IncrementalPillars.is_aligned(net, window)
        ):
            return UncachedInference(self, window)
        if self._cells is None:
            self._cells = SparseBackbone(net.backbone, net.heads, self._dtype)
        return IncrementalPillars(net, self._cells, window, self.proposals, self._proposals)
