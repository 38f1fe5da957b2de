"""PointPillars through the editions of one scene: only cells that changed and are needed are computed again.

Layer by layer, the cells that changed AND are needed; all other activations are those of earlier calls. Backward
likewise: only through cells between a point whose gradient is asked for and a logit that carries one.

Cells, not rectangles: what an object hides and uncovers changes single cells all along its shadow, and on streets
the bounding rectangle of all changes would hold 1.1 to 2 times the operations.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.base import BevWindow, Proposals
from shift3d.detectors.cell_backbone import CellBackbone, CellCache, CellTape
from shift3d.detectors.cell_sets import CellNumbers, CellSet, empty_set
from shift3d.detectors.followed_points import FollowedPoints, contains
from shift3d.detectors.pointpillars import PointPillarsNet

__all__ = ["PillarFollower"]

Plain = Callable[[Tensor, BevWindow], Proposals]
Boxed = Callable[[Tensor, Tensor, Tensor, BevWindow], Proposals]
_Rectangle = tuple[int, int, int, int]


class PillarFollower:
    """Follows PointPillars. Not for use from several threads at once."""

    def __init__(
        self, net: PointPillarsNet, cells: CellBackbone, window: BevWindow, plain: Plain, boxed: Boxed
    ) -> None:
        """net: for inference. cells: its backbone.

        plain: the detector's own proposals, for windows beyond the followed one. boxed: (logits, codes, direction
        logits, window) -> proposals.
        """
        self._net, self._cells, self._window, self._plain, self._boxed = net, cells, window, plain, boxed
        self._points = FollowedPoints(net.grid, window, cells.exact)
        self._shape = self._points.shape
        self._cache = CellCache(cells, self._shape)
        self._core: _Rectangle | None = None
        self._outputs, self._needed = empty_set(self._shape), list[CellSet]()

    @staticmethod
    def can_follow(net: PointPillarsNet, window: BevWindow) -> bool:
        """Whether the window is a whole number of the coarsest map's cells."""
        stride = net.spec.total_strides[-1]
        return all(span % stride == 0 for span in (window.x0, window.y0, window.num_x, window.num_y))

    def proposals(self, points: Tensor, window: BevWindow | None = None, live: Tensor | None = None) -> Proposals:
        """See `Follower`. A window that reaches beyond the followed one is computed as a whole.

        Deterministic to the bit for the same calls in the same order; the same points after other calls may
        differ by rounding. Not differentiable twice.
        """
        window = window or self._window
        if points.ndim != 2 or points.shape[1] != 3 or not contains(self._window, window):
            return self._plain(points, window)
        core = self._look_at(window)
        points = points.to(self._cells.exact)
        tracked = torch.is_grad_enabled() and points.requires_grad
        with torch.no_grad():
            due = self._cache.due(self._points.changed(points.detach()), self._needed[0])
            live_cells = self._points.cells(live) & self._needed[0] if tracked else empty_set(self._shape)
            self._write(points.detach(), due & ~live_cells, due)
        features, cells = self._write(points, live_cells, due)
        with torch.no_grad():
            self._cache.advance(due, self._needed, self._outputs)
            outputs, anchors = self._cache.heads(core), self._cells.anchors
            logits = outputs[..., :anchors].reshape(-1)
            codes = outputs[..., anchors : 8 * anchors].reshape(-1, 7)
            directions = outputs[..., 8 * anchors :].reshape(-1, 2)
        if features.requires_grad:
            tape = self._cache.tape(live_cells, self._needed, self._outputs)
            logits = _Link.apply(features, logits, tape, cells, core)  # type: ignore[no-untyped-call]
        return self._boxed(logits, codes, directions, window)

    def _look_at(self, window: BevWindow) -> _Rectangle:
        """The window's core (y0, x0, height, width) in the followed window; it is what the next steps compute."""
        followed = self._window
        core = (window.core_y0 - followed.y0, window.core_x0 - followed.x0, window.core_num_y, window.core_num_x)
        if core != self._core:
            y0, x0, height, width = core
            outputs = empty_set(self._shape)
            outputs[1 + y0 : 1 + y0 + height, 1 + x0 : 1 + x0 + width] = True
            self._core, self._outputs, self._needed = core, outputs, self._cells.needed(outputs)
        return core

    def _write(self, points: Tensor, among: CellSet, due: CellSet) -> tuple[Tensor, CellNumbers]:
        """The features (P, C) of the pillars among these cells, and their cells; those due go into the canvas."""
        rows = self._points.rows(among)
        pillars, features = self._net.pillar_features(points.index_select(0, rows), self._window)
        cells = self._points.numbers(pillars)
        features = features.to(self._cache.canvas.dtype)
        to_write = due & among
        fresh = to_write.reshape(-1)[cells]
        with torch.no_grad():
            self._cache.canvas[torch.from_numpy(np.flatnonzero(to_write))] = 0.0
            self._cache.canvas[torch.from_numpy(cells[fresh])] = features[torch.from_numpy(fresh)]
        return features, cells


class _Link(torch.autograd.Function):
    """Hangs logits that were computed already to the pillar features that they depend on."""

    @staticmethod
    def forward(
        ctx: Any, features: Tensor, logits: Tensor, tape: CellTape, cells: CellNumbers, core: _Rectangle
    ) -> Tensor:
        """features (P, C) of the pillars in `cells`, ascending; logits (A,) of the core."""
        ctx.tape, ctx.cells, ctx.core, ctx.dtype = tape, cells, core, features.dtype
        return logits.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """The gradient at the features; None for the rest."""
        tape: CellTape = ctx.tape
        y0, x0, height, width = ctx.core
        shape = tape.shapes[0]
        everywhere = gradient.new_zeros(shape.height + 2, shape.width + 2, tape.net.anchors)
        everywhere[1 + y0 : 1 + y0 + height, 1 + x0 : 1 + x0 + width] = gradient.view(height, width, -1)
        at_cells = tape.gradient(everywhere.view(-1, tape.net.anchors))
        rows = torch.from_numpy(np.searchsorted(tape.cells[0], ctx.cells))
        return at_cells.index_select(0, rows).to(ctx.dtype), None, None, None, None
