"""PointPillars and CenterPoint: one encoder and backbone, under heads with anchors and without."""

from __future__ import annotations

from shift3d.detectors.grid import WAYMO_GRID, Grid
from shift3d.detectors.models.anchor_heads import WAYMO_ANCHORS, AnchorHeads, AnchorSpec
from shift3d.detectors.models.backbone import WAYMO_BACKBONE, BackboneSpec
from shift3d.detectors.models.centre_heads import CentreHeads
from shift3d.detectors.models.pillar_backbone import PillarBackboneNet


class PointPillarsNet(PillarBackboneNet):
    """Points -> logits, codes, direction logits of every anchor in the window's core.

    Source: PointPillars (Lang et al. 2019), see `PillarBackboneNet`.
    """

    name = "pointpillars"

    def __init__(
        self, spec: BackboneSpec = WAYMO_BACKBONE, grid: Grid = WAYMO_GRID, anchors: AnchorSpec = WAYMO_ANCHORS
    ) -> None:
        super().__init__(spec, grid)
        self.heads = AnchorHeads(spec.up_channels * len(spec.strides), anchors)


class CenterPointNet(PillarBackboneNet):
    """Points -> heat map and box of every cell of the window's core.

    Source: CenterPoint (Yin et al. 2021), first stage, on pillars. Our choice: the heads are 1x1 convolutions as
    PointPillars has them (published: a shared 3x3 and one more a head), so that windows and incremental inference cost
    the same.
    """

    name = "centerpoint"

    def __init__(self, spec: BackboneSpec = WAYMO_BACKBONE, grid: Grid = WAYMO_GRID) -> None:
        super().__init__(spec, grid)
        self.heads = CentreHeads(spec.up_channels * len(spec.strides))
