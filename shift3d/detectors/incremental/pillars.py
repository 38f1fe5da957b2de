"""Incremental inference of pillar detectors across the frames of one scene.

Each layer recomputes the cells that changed AND are needed; other activations come from earlier calls. The backward
pass runs only through cells between a point that needs a gradient and a logit that has one.

Sets of single cells replace rectangles because an object changes cells all along its shadow: on streets the bounding
rectangle of all changes would cost 1.1 to 2 times the operations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.incremental.activation_cache import ActivationCache
from shift3d.detectors.incremental.active_sites import CellIndices, CellMask, PointCells, empty_mask
from shift3d.detectors.incremental.inference import CachedInference, Plain
from shift3d.detectors.incremental.sparse_backbone import SparseBackbone, SparseBackward
from shift3d.detectors.models.pillar_detectors import PillarBackboneNet

Boxed = Callable[[Tensor, Tensor, BevWindow], Proposals]
_Rectangle = tuple[int, int, int, int]


class IncrementalPillars(CachedInference):
    """Incremental inference of a pillar detector. Not differentiable twice.

    net: for inference. cells: backbone of `net` as matrices. boxed: (logits, outputs of the box layers, window) ->
    proposals.
    """

    def __init__(
        self, net: PillarBackboneNet, cells: SparseBackbone, window: BevWindow, plain: Plain, boxed: Boxed
    ) -> None:
        super().__init__(window, cells.exact, plain, net, cells, boxed)
        self._net, self._cells, self._boxed = net, cells, boxed
        self._points = PointCells(net.grid, window, cells.exact)
        self._shape = self._points.shape
        self._cache = ActivationCache(cells, self._shape)
        self._core: _Rectangle | None = None
        self._outputs, self._needed = empty_mask(cells.output_shape(self._shape)), list[CellMask]()

    @staticmethod
    def is_aligned(net: PillarBackboneNet, window: BevWindow) -> bool:
        """True if the window consists of whole cells of the coarsest map."""
        stride = net.spec.total_strides[-1]
        return all(span % stride == 0 for span in (window.x0, window.y0, window.num_x, window.num_y))

    def _cached(self, points: Tensor, window: BevWindow, requires_grad: Tensor | None) -> Proposals:
        core = self._look_at(window)
        tracked = torch.is_grad_enabled() and points.requires_grad
        with torch.no_grad():
            due = self._cache.due(self._points.changed(points.detach()), self._needed[0])
            grad_cells = self._points.cells(requires_grad) & self._needed[0] if tracked else empty_mask(self._shape)
            self._write(points.detach(), due & ~grad_cells, due)
        features, cells = self._write(points, grad_cells, due)
        with torch.no_grad():
            self._cache.advance(due, self._needed, self._outputs)
            outputs, classes = self._cache.heads(core).flatten(0, 1), self._cells.per_cell
            logits, rows = outputs[:, :classes].reshape(-1), outputs[:, classes:]
        if features.requires_grad:
            sparse = self._cache.backward(grad_cells, self._needed, self._outputs)
            logits = _AttachGradient.apply(features, logits, sparse, cells, core)  # type: ignore[no-untyped-call]
        return self._boxed(logits, rows, window)

    def _look_at(self, window: BevWindow) -> _Rectangle:
        """Set the output cells to the window's core. Return the core (y0, x0, height, width) in output cells."""
        cached = self._window
        step = self._cells.out_stride
        y0, x0 = (window.core_y0 - cached.y0) // step, (window.core_x0 - cached.x0) // step
        core = (y0, x0, window.core_num_y // step, window.core_num_x // step)
        if core != self._core:
            outputs = empty_mask(self._cells.output_shape(self._shape))
            outputs[1 + y0 : 1 + y0 + core[2], 1 + x0 : 1 + x0 + core[3]] = True
            self._core, self._outputs, self._needed = core, outputs, self._cells.needed(outputs)
        return core

    def _write(self, points: Tensor, among: CellMask, due: CellMask) -> tuple[Tensor, CellIndices]:
        """Return features (P, C) and cells of the pillars in `among`; write the features of due cells to the canvas."""
        rows = self._points.rows(among)
        pillars, features = self._net.pillar_features(points.index_select(0, rows), self._window)
        cells = self._points.indices(pillars)
        features = features.to(self._cache.canvas.dtype)
        to_write = due & among
        fresh = to_write.reshape(-1)[cells]
        with torch.no_grad():
            self._cache.canvas[torch.from_numpy(np.flatnonzero(to_write))] = 0.0
            self._cache.canvas[torch.from_numpy(cells[fresh])] = features[torch.from_numpy(fresh)]
        return features, cells


class _AttachGradient(torch.autograd.Function):
    """Autograd link from precomputed logits to the pillar features that they depend on."""

    @staticmethod
    def forward(
        ctx: Any, features: Tensor, logits: Tensor, sparse: SparseBackward, cells: CellIndices, core: _Rectangle
    ) -> Tensor:
        """Return the logits (A,) of the core. features: (P, C) of the pillars in `cells`, ascending."""
        ctx.sparse, ctx.cells, ctx.core, ctx.dtype = sparse, cells, core, features.dtype
        return logits.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """Compute the gradient w.r.t. the features; None for the other inputs."""
        sparse: SparseBackward = ctx.sparse
        y0, x0, height, width = ctx.core
        shape = sparse.net.output_shape(sparse.shapes[0])
        everywhere = gradient.new_zeros(shape.height + 2, shape.width + 2, sparse.net.per_cell)
        everywhere[1 + y0 : 1 + y0 + height, 1 + x0 : 1 + x0 + width] = gradient.view(height, width, -1)
        at_cells = sparse.gradient(everywhere.view(-1, sparse.net.per_cell))
        rows = torch.from_numpy(np.searchsorted(sparse.cells[0], ctx.cells))
        return at_cells.index_select(0, rows).to(ctx.dtype), None, None, None, None
