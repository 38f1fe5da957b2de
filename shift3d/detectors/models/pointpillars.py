"""PointPillars: pillars, a convolutional backbone, anchors."""

from __future__ import annotations

from shift3d.detectors.grid import WAYMO_GRID, Grid
from shift3d.detectors.models.anchor_heads import AnchorHeads
from shift3d.detectors.models.anchors import WAYMO_ANCHORS, AnchorSpec
from shift3d.detectors.models.backbone import WAYMO_BACKBONE, BackboneSpec
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
