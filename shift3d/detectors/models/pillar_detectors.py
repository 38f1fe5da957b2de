"""PointPillars and CenterPoint, for training and, folded, for inference: same encoder and backbone, different heads."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, Self

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import WAYMO_GRID, Grid, Pillars
from shift3d.detectors.models.anchor_heads import WAYMO_ANCHORS, AnchorHeads, AnchorSpec
from shift3d.detectors.models.backbone import WAYMO_BACKBONE, Backbone, BackboneSpec
from shift3d.detectors.models.centre_heads import CentreHeads
from shift3d.detectors.models.folding import folded_sequence
from shift3d.detectors.models.network import DetectorNet, Precision, precision_dtypes
from shift3d.detectors.models.pillar_net import PillarNet, decorate

# Memory layout of the backbone at inference per dtype; default contiguous. The gradient of a core arrives in contiguous
# slices: in float32, channels last made the backward pass 1.4 to 1.5 times slower (415 to 460 ms against 296 to 305 on
# one CPU core, weights frozen), the forward pass equal within noise. The bfloat16 kernels need channels last.
_LAYOUT = {torch.bfloat16: torch.channels_last}


class PillarEncoder(Protocol):
    """Encoder from decorated points (see `PillarBackboneNet.decorated`) to one feature per pillar."""

    def __call__(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        """Encode (K, inputs) to (P, channels). Differentiable w.r.t. decorated."""
        ...

    def folded(self) -> Self:
        """Return the same function in evaluation mode with folded norms."""
        ...


class PillarBackboneNet(DetectorNet):
    """Network from points to pillars to one feature per cell of the window's core; a subclass adds the heads.

    Source: PointPillars (Lang et al. 2019) in the Waymo configuration that SHIFT3D follows; dynamic voxelisation
    instead of at most 20 points a pillar (our choice: see shift3d.detectors.grid).
    """

    pillar_net: PillarEncoder

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE, grid: Grid = WAYMO_GRID) -> None:
        super().__init__()
        self.spec = spec
        self.grid = grid
        self.channels = spec.in_channels
        self.pillar_net = PillarNet(spec.in_channels)
        self.backbone = Backbone(spec)

    @property
    def supports_incremental(self) -> bool:
        """True if every block is upsampled (factor >= 1) to the output map, as incremental inference needs."""
        return self.spec.out_stride <= min(self.spec.total_strides)

    @property
    def head_grid(self) -> Grid:
        """Grid of the heads: coarser than the pillar grid by the backbone's output stride."""
        grid, step = self.grid, self.spec.out_stride
        return replace(grid, cell_m=grid.cell_m * step, num_x=grid.num_x // step, num_y=grid.num_y // step)

    def head_window(self, window: BevWindow) -> BevWindow:
        return BevWindow(*(cells // self.spec.out_stride for cells in vars(window).values()))

    def decorated(self, points: Tensor, pillars: Pillars) -> Tensor:
        return decorate(points, pillars, self.grid)

    def encode(self, decorated: Tensor, pillars: Pillars) -> Tensor:
        return self.pillar_net(decorated, pillars)

    def canvas(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """Compute pillar features on the dense grid: (B, C, H, W), channels last in memory, zero in empty pillars.

        clouds: (N_b, 3) each, network frame. Differentiable w.r.t. the points.
        """
        height, width = windows[0].num_y, windows[0].num_x
        pillars, features = self.batch_features(clouds, windows, pillars)
        cells = [
            (found.cell_y - window.y0 + index * height) * width + found.cell_x - window.x0
            for index, (found, window) in enumerate(zip(pillars, windows, strict=True))
        ]
        dense = features.new_zeros(len(clouds) * height * width, self.channels)
        dense = dense.index_copy(0, torch.cat(cells), features)
        return dense.view(len(clouds), height, width, self.channels).permute(0, 3, 1, 2)

    def core_span(self, low: int, high: int, cells: int) -> tuple[int, int]:
        """Return the interval aligned to the backbone's coarsest stride, inside the grid."""
        stride = self.spec.coarsest_stride
        return max(0, low) // stride * stride, min(cells, -(-min(cells, high) // stride) * stride)

    def outer_span(self, core_low: int, core_high: int, cells: int) -> tuple[int, int]:
        """Return the core and the receptive field around it, aligned to the stride."""
        stride, margin = self.spec.coarsest_stride, self.spec.margin_cells
        low = max(0, (core_low - margin) // stride * stride)
        return low, min(cells, -(-(core_high + margin) // stride) * stride)

    def features(
        self, clouds: Sequence[Tensor], windows: Sequence[BevWindow], pillars: Sequence[Pillars] | None = None
    ) -> Tensor:
        """Compute the features (B, 384, h, w) of the windows' cores, see `DetectorNet`."""
        return self.core_features(self.canvas(clouds, windows, pillars), core_in_window(windows[0]))

    def core_features(self, canvas: Tensor, core: tuple[int, int, int, int]) -> Tensor:
        """Compute features of a core (y0, x0, height, width) of a canvas, in canvas cells, aligned to the stride."""
        weight: Tensor = self.backbone.blocks[0][0].weight  # type: ignore[index]
        canvas = canvas.to(weight.dtype)
        if not weight.is_contiguous(memory_format=torch.channels_last):
            canvas = canvas.contiguous()  # else every convolution uses the layout of the canvas, not of its weights
        result: Tensor = self.backbone(canvas, core)
        return result

    def inference(self, precision: Precision) -> Self:
        """Return a copy for inference, norms and gains folded in float64; its pillar network is float32 or float64."""
        exact, dense = precision_dtypes(precision)
        folded = copy.deepcopy(self)
        folded.pillar_net = folded.pillar_net.folded()
        for group in (folded.backbone.blocks, folded.backbone.ups):
            for index, sequence in enumerate(group):
                assert isinstance(sequence, nn.Sequential)
                group[index] = folded_sequence(sequence)
        folded = folded.eval().requires_grad_(False).to(exact)
        for part in (folded.backbone, *folded.heads.layers):
            cast_large_products(part, dense)
        return folded


def core_in_window(window: BevWindow) -> tuple[int, int, int, int]:
    """Return (y0, x0, height, width) of the core in cells of the window."""
    return (window.core_y0 - window.y0, window.core_x0 - window.x0, window.core_num_y, window.core_num_x)


def cast_large_products(part: nn.Module, dense: torch.dtype) -> None:
    """Convert a part of the network in place to the dtype of the large products and its fast memory layout."""
    part.to(dense).to(memory_format=_LAYOUT.get(dense, torch.contiguous_format))  # type: ignore[call-overload]


class PointPillarsNet(PillarBackboneNet):
    """PointPillars: logits, box codes and direction logits of the core's anchors. Source: see `PillarBackboneNet`."""

    name = "pointpillars"

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE, anchors: AnchorSpec = WAYMO_ANCHORS) -> None:
        super().__init__(spec)
        self.heads = AnchorHeads(spec.up_channels * len(spec.strides), anchors)


class CenterPointNet(PillarBackboneNet):
    """CenterPoint: heat map and box of every cell of the window's core.

    Source: CenterPoint (Yin et al. 2021), first stage, on pillars. Our choice: 1x1 convolutions as heads, as in
    PointPillars (published: a shared 3x3 and one per head), so that windows and incremental inference cost the same.
    """

    name = "centerpoint"

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE) -> None:
        super().__init__(spec)
        self.heads = CentreHeads(spec.up_channels * len(spec.strides))


PILLAR_NETWORKS: dict[str, type[PillarBackboneNet]] = {"anchors": PointPillarsNet, "centres": CenterPointNet}
"""Networks by their kind of heads."""
