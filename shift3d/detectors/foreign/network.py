"""A foreign model's network, of the parts that the shipped pillar detectors have where these compute the same."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Self

from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.foreign.encoder import ForeignEncoder, foreign_inputs
from shift3d.detectors.foreign.heads import CentreTower, ForeignAnchorHeads, MapHeads
from shift3d.detectors.foreign.layout import Anchor, AnchorHead, Layout
from shift3d.detectors.grid import Grid, Pillars
from shift3d.detectors.models.network import Precision, arithmetic
from shift3d.detectors.models.pillar_backbone import PillarBackboneNet, core_in_window, to_dense


class ForeignNet(PillarBackboneNet):
    """PointPillars or CenterPoint on pillars by a layout, in the model's own frame. For inference alone."""

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout.backbone, layout.grid)
        self.name, self.layout = layout.source, layout
        self.pillar_net = ForeignEncoder(layout.inputs)
        _set_eps(self.backbone.blocks, layout.backbone_eps)
        _set_eps(self.backbone.ups, layout.neck_eps)
        channels = layout.backbone.up_channels * len(layout.backbone.strides)
        self.tower: CentreTower | None = None
        if isinstance(layout.head, AnchorHead):
            self.heads: ForeignAnchorHeads | MapHeads = ForeignAnchorHeads(channels, layout.head)
            self._reach_cells = max(_displacement(anchor, self.head_grid) for anchor in layout.head.anchors)
        else:
            self.tower, self.heads, self._reach_cells = CentreTower(channels, layout.head), MapHeads(), 0

    @property
    def is_cellwise(self) -> bool:
        return self.tower is None and super().is_cellwise

    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        return foreign_inputs(points, pillars, self.grid, self.layout.inputs)

    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """See `DetectorNet`; anchors that do not stand in their cell's centre are all covered."""
        more = self._reach_cells * self.spec.out_stride
        return super().core_span(low - more, high + more, cells)

    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        return super().outer_span(*self._before_tower(core_low, core_high, 0, cells), cells)

    def _before_tower(self, low: int, high: int, first: int, last: int) -> tuple[int, int]:
        """The stretch of an axis, within [first, last), whose features the tower reads for [low, high)."""
        reach = self.tower.reach * self.spec.out_stride if self.tower is not None else 0
        stride = self.spec.total_strides[-1]
        return max(first, (low - reach) // stride * stride), min(last, -(-(high + reach) // stride) * stride)

    def features(self, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> Tensor:
        """See `DetectorNet`; behind the tower, where there is one."""
        if self.tower is None:
            return super().features(clouds, windows)
        y0, x0, height, width = core_in_window(windows[0])
        low_y, high_y = self._before_tower(y0, y0 + height, 0, windows[0].num_y)
        low_x, high_x = self._before_tower(x0, x0 + width, 0, windows[0].num_x)
        around = self.core_features(clouds, windows, (low_y, low_x, high_y - low_y, high_x - low_x))
        step = self.spec.out_stride
        top, left = (y0 - low_y) // step, (x0 - low_x) // step
        result: Tensor = self.tower(around)[:, :, top : top + height // step, left : left + width // step]
        return result

    def inference(self, precision: Precision) -> Self:
        folded = super().inference(precision)
        if folded.tower is not None:
            to_dense(folded.tower.folded(), arithmetic(precision)[1])
        return folded.requires_grad_(False)


def _set_eps(part: nn.Module, eps: float) -> None:
    for module in part.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eps = eps


def _displacement(anchor: Anchor, grid: Grid) -> int:
    """How many cells an anchor stands away from its cell's centre at most, rounded up."""
    centres = []
    for low, count in ((grid.x_min_m, grid.num_x), (grid.y_min_m, grid.num_y)):
        centres += [low + 0.5 * grid.cell_m, low + (count - 0.5) * grid.cell_m]
    away = max(abs(found - centre) for found, centre in zip((*anchor.x_m, *anchor.y_m), centres, strict=True))
    return ceil(away / grid.cell_m - 1e-6)
