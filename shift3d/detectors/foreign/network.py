"""Network of a foreign model: shipped modules where they compute the same, otherwise modules as in its codebase."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from typing import Self

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.foreign.layout import Anchor, AnchorHead, Branch, CentreHead, Layout, PillarInputs
from shift3d.detectors.grid import Grid, Pillars, core_cells
from shift3d.detectors.models.anchor_heads import AnchorConvolutions
from shift3d.detectors.models.centre_heads import decode_centres
from shift3d.detectors.models.folding import folded_linear, folded_sequence
from shift3d.detectors.models.network import BoxHeads, Precision, map_to_rows, precision_dtypes
from shift3d.detectors.models.pillar_detectors import PillarBackboneNet, cast_large_products, core_in_window
from shift3d.detectors.models.pillar_net import decorate, segment_max


def foreign_inputs(points: Tensor, pillars: Pillars, grid: Grid, inputs: PillarInputs) -> Tensor:
    """Compute position, constants, offset from the pillar's mean and from its centre in x, y, z: (K, columns).

    Rows are sorted by pillar. points: (N, 3), model's frame, metres. Differentiable w.r.t. points. Source: OpenPCDet's
    PillarVFE; mmdetection3d's PillarFeatureNet, whose `legacy` puts the offset from the centre over the coordinates.
    """
    decorated = decorate(points, pillars, grid)
    xyz, to_mean = decorated[:, :3], decorated[:, 3:6]
    to_centre = torch.cat((decorated[:, 6:], xyz[:, 2:] - inputs.middle_m), dim=1)
    place = {"coordinates": xyz, "offset": to_centre, "none": xyz[:, :0]}[inputs.position]
    constants = xyz.new_tensor(inputs.constants).expand(len(xyz), -1)
    return torch.cat((place, constants, to_mean, to_centre), dim=1)


class ForeignEncoder(nn.Module):
    """Layers of linear, norm and ReLU; all but the last concatenate each point with its pillar's maximum.

    Both codebases pad a pillar to its slots with zeros after decoration, and the maximum includes the padding: here one
    point of zeros represents all padding of a pillar. A full pillar keeps every point (our choice: the sources keep as
    many as there are slots, and which points depends on their order).
    """

    def __init__(self, inputs: PillarInputs) -> None:
        super().__init__()
        self.slots = inputs.slots
        halves = [*(width // 2 for width in inputs.filters[:-1]), inputs.filters[-1]]
        sources = [inputs.columns, *inputs.filters[:-1]]
        self.linears = nn.ModuleList(
            nn.Linear(source, width, bias=False) for source, width in zip(sources, halves, strict=True)
        )
        self.norms = nn.ModuleList(nn.BatchNorm1d(width, eps=inputs.eps) for width in halves)

    def forward(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """Encode (K, columns), sorted by pillar, to (P, channels). Differentiable; ties share gradients equally."""
        features, owner, counts = decorated, pillars.pillar, pillars.counts
        if self.slots is not None:
            short = torch.nonzero(counts < self.slots).flatten()
            owner = torch.cat((owner, short))
            order = torch.argsort(owner, stable=True)
            features = torch.cat((features, features.new_zeros(len(short), features.shape[1]))).index_select(0, order)
            owner, counts = owner.index_select(0, order), counts + (counts < self.slots)
        for index, (linear, norm) in enumerate(zip(self.linears, self.norms, strict=True)):
            features = torch.relu(norm(linear(features)))
            highest = segment_max(features, owner, counts)
            if index + 1 < len(self.linears):
                features = torch.cat((features, highest.index_select(0, owner)), dim=1)
        return highest

    def folded(self) -> Self:
        """Fold the norms into the layers, in place: the same function in evaluation mode. Return self."""
        for index, (linear, norm) in enumerate(zip(self.linears, self.norms, strict=True)):
            assert isinstance(linear, nn.Linear)
            self.linears[index], self.norms[index] = folded_linear(linear, norm), nn.Identity()
        return self


class ForeignAnchorHeads(AnchorConvolutions):
    """1x1 convolutions for vehicle logit, box and direction of every anchor, including anchors of other classes."""

    def __init__(self, channels: int, head: AnchorHead) -> None:
        super().__init__(channels, len(head.anchors))
        self.head, self.direction_offset_rad = head, head.direction_offset_rad

    def anchor_rows(self, grid: Grid, window: BevWindow) -> Tensor:
        """Return the anchors (A, 7) float64 of the core, model's frame, ordered by y, then x, then anchor of a cell."""
        lines, columns = core_cells(window)
        boxes = []
        for anchor in self.head.anchors:
            y = _spaced(anchor.y_m, grid.num_y)[lines][:, None].expand(-1, len(columns))
            x = _spaced(anchor.x_m, grid.num_x)[columns].expand(len(lines), -1)
            rest = torch.tensor((anchor.z_m, *anchor.size_m, anchor.heading_rad), dtype=torch.float64)
            boxes.append(torch.cat((torch.stack((x, y), dim=-1), rest.expand(*x.shape, 5)), dim=-1))
        return torch.stack(boxes, dim=2).reshape(-1, 7)


def _spaced(ends: tuple[float, float], count: int) -> Tensor:
    return torch.linspace(*ends, count, dtype=torch.float64)


def _stack(channels: int, hidden: int, branch: Branch, head: CentreHead) -> nn.Sequential:
    modules: list[nn.Module] = []
    for _ in range(branch.layers - 1):
        modules += _convolution(channels, hidden, head)
        channels = hidden
    return nn.Sequential(*modules, nn.Conv2d(channels, branch.outputs, 3, padding=1))


def _convolution(channels: int, outputs: int, head: CentreHead) -> list[nn.Module]:
    layer = nn.Conv2d(channels, outputs, 3, padding=1, bias=head.biased)
    return [layer, nn.BatchNorm2d(outputs, eps=head.eps), nn.ReLU()]


class CentreTower(nn.Module):
    """Shared convolution and branches of the vehicle's task: features (B, C, h, w) -> (B, 1 + 8, h, w).

    Channels: vehicle logit, offset x and y (cells), z, log of the sizes, sine and cosine of the heading. Differentiable
    w.r.t. features only through the logit: boxes are detached.
    """

    def __init__(self, channels: int, head: CentreHead) -> None:
        super().__init__()
        self.reach = 1 + max(branch.layers for branch in (head.heat, *head.branches[:4]))  # cells to either side
        self.shared = nn.Sequential(*_convolution(channels, head.shared, head))
        self.classes = _stack(head.shared, head.hidden, head.heat, head)
        self.boxes = nn.ModuleList(_stack(head.shared, head.hidden, branch, head) for branch in head.branches[:4])

    def forward(self, features: Tensor) -> Tensor:
        shared = self.shared(features)
        logits = self.classes(shared)
        with torch.no_grad():
            boxes = [branch(shared) for branch in self.boxes]
        return torch.cat((logits, *boxes), dim=1)

    def folded(self) -> Self:
        """Fold the norms into the convolutions, in place: the same function in evaluation mode. Return self."""
        self.shared, self.classes = folded_sequence(self.shared), folded_sequence(self.classes)
        for index, branch in enumerate(self.boxes):
            assert isinstance(branch, nn.Sequential)
            self.boxes[index] = folded_sequence(branch)
        return self


class TowerOutputHeads(BoxHeads):
    """Heads that read logit and box code from `CentreTower`; all cells enter suppression, as in the sources."""

    per_cell = 1
    box_layers = ()
    layers = ()

    def logits(self, features: Tensor) -> Tensor:
        return map_to_rows(features[:, :1]).flatten(1)

    def box_rows(self, features: Tensor) -> Tensor:
        return map_to_rows(features[:, 1:])

    def decode(self, rows: Tensor, grid: Grid, window: BevWindow) -> Tensor:
        """See `BoxHeads.decode`. In the sources the offset is relative to the corner of the cell.

        Source: OpenPCDet's centernet_utils, mmdetection3d's CenterPointBBoxCoder.
        """
        lines, columns = core_cells(window)
        y, x = torch.meshgrid(lines, columns, indexing="ij")
        codes = torch.cat((rows[:, :2] - 0.5, rows[:, 2:]), dim=1)
        return decode_centres(codes, torch.stack((x.reshape(-1), y.reshape(-1)), dim=1), grid)


class ForeignNet(PillarBackboneNet):
    """PointPillars or CenterPoint on pillars as a layout describes, in the model's frame. For inference only."""

    def __init__(self, layout: Layout) -> None:
        super().__init__(layout.backbone, layout.grid)
        self.name, self.layout = layout.source, layout
        self.pillar_net = ForeignEncoder(layout.inputs)
        _set_eps(self.backbone.blocks, layout.backbone_eps)
        _set_eps(self.backbone.ups, layout.neck_eps)
        channels = layout.backbone.up_channels * len(layout.backbone.strides)
        self.tower: CentreTower | None = None
        if isinstance(layout.head, AnchorHead):
            self.heads: ForeignAnchorHeads | TowerOutputHeads = ForeignAnchorHeads(channels, layout.head)
            self._reach_cells = max(_displacement(anchor, self.head_grid) for anchor in layout.head.anchors)
        else:
            self.tower, self.heads, self._reach_cells = CentreTower(channels, layout.head), TowerOutputHeads(), 0

    @property
    def supports_incremental(self) -> bool:
        return self.tower is None and super().supports_incremental

    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        return foreign_inputs(points, pillars, self.grid, self.layout.inputs)

    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """See `DetectorNet`; the core also covers anchors that are displaced from the centre of their cell."""
        more = self._reach_cells * self.spec.out_stride
        return super().core_span(low - more, high + more, cells)

    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        return super().outer_span(*self._before_tower(core_low, core_high, 0, cells), cells)

    def _before_tower(self, low: int, high: int, first: int, last: int) -> tuple[int, int]:
        """Return the interval, within [first, last), of the features that the tower reads for outputs [low, high)."""
        reach = self.tower.reach * self.spec.out_stride if self.tower is not None else 0
        stride = self.spec.coarsest_stride
        return max(first, (low - reach) // stride * stride), min(last, -(-(high + reach) // stride) * stride)

    def features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """See `DetectorNet`; these are the outputs of the tower if there is one."""
        if self.tower is None:
            return super().features(clouds, windows, pillars)
        y0, x0, height, width = core_in_window(windows[0])
        low_y, high_y = self._before_tower(y0, y0 + height, 0, windows[0].num_y)
        low_x, high_x = self._before_tower(x0, x0 + width, 0, windows[0].num_x)
        canvas = self.canvas(clouds, windows, pillars)
        around = self.core_features(canvas, (low_y, low_x, high_y - low_y, high_x - low_x))
        step = self.spec.out_stride
        top, left = (y0 - low_y) // step, (x0 - low_x) // step
        result: Tensor = self.tower(around)[:, :, top : top + height // step, left : left + width // step]
        return result

    def inference(self, precision: Precision) -> Self:
        folded = super().inference(precision)
        if folded.tower is not None:
            cast_large_products(folded.tower.folded(), precision_dtypes(precision)[1])
        return folded.requires_grad_(False)


def _set_eps(part: nn.Module, eps: float) -> None:
    for module in part.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eps = eps


def _displacement(anchor: Anchor, grid: Grid) -> int:
    """Compute the largest distance, in cells, of an anchor from the centre of its cell, rounded up."""
    centres = []
    for low, count in ((grid.x_min_m, grid.num_x), (grid.y_min_m, grid.num_y)):
        centres += [low + 0.5 * grid.cell_m, low + (count - 0.5) * grid.cell_m]
    away = max(abs(found - centre) for found, centre in zip((*anchor.x_m, *anchor.y_m), centres, strict=True))
    return ceil(away / grid.cell_m - 1e-6)
