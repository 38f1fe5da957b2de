"""Architecture of a foreign model in plain values, independent of the format of its config.

The planner of a sweep makes the layout once. Workers and task ids use the layout, not the config.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec


class _Values(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PillarInputs(_Values):
    """Inputs and layers of the pillar network.

    position: first input columns: coordinates, offset from the pillar's centre, or none. constants: values for the
    channels other than coordinates. middle_m: height of the pillar's centre. slots: points per pillar in the source; a
    pillar with fewer points gets one additional point of zeros; None: no limit. filters: output width of each layer; in
    all but the last, half is per point and half is the pillar's maximum. named: name of the layers in the source.
    """

    position: Literal["coordinates", "offset", "none"]
    constants: tuple[float, ...]
    middle_m: float
    slots: int | None
    filters: tuple[int, ...]
    named: str = "pfn_layers"
    eps: float = 1e-3

    @property
    def columns(self) -> int:
        """Number of input values per point."""
        return (0 if self.position == "none" else 3) + len(self.constants) + 6


class Anchor(_Values):
    """One anchor of each cell; metres and radians, model's frame. z_m: height of its centre.

    x_m, y_m: positions in the first and last column or row; the others are evenly spaced.
    """

    size_m: tuple[float, float, float]
    heading_rad: float
    z_m: float
    x_m: tuple[float, float]
    y_m: tuple[float, float]


class AnchorHead(_Values):
    """1x1 convolutions. classes: per anchor; vehicle: index of the class to keep. code_size: values per box, >= 7."""

    kind: Literal["anchors"] = "anchors"
    anchors: tuple[Anchor, ...]
    classes: int
    vehicle: int
    code_size: int
    direction_offset_rad: float


class Branch(_Values):
    """Stack of 3x3 convolutions after the shared one. name: in the source."""

    name: str
    outputs: int
    layers: int


class CentreHead(_Values):
    """Centre head: a shared 3x3 convolution, and branches for each task.

    tasks: number of classes per task; task, vehicle: task of the class to keep, and its index in the task. branches:
    box branches in the source's order; the first four are offset, height, size, heading. heat: branch of the heat map.
    shared: channels after the shared convolution; hidden: channels within a branch. biased: convolutions before a norm
    have a bias. sine_first: heading is (sine, cosine), else (cosine, sine).
    """

    kind: Literal["centre"] = "centre"
    tasks: tuple[int, ...]
    task: int
    vehicle: int
    branches: tuple[Branch, ...]
    heat: Branch
    shared: int
    hidden: int
    biased: bool
    sine_first: bool
    eps: float = 1e-5


class Frame(_Values):
    """Model's frame relative to the network frame, whose origin is on the ground and whose x points forward.

    height_m: of the model's origin above the ground. turned: its x points right and its y forward, as in nuScenes.
    """

    height_m: float
    turned: bool


class Layout(_Values):
    """Architecture of a whole model.

    source: codebase that named the tensors. prefix: of mmdetection3d's module names. plain_up: upsampling by 1 is an
    ordinary convolution. suppression_iou: IoU threshold of the source's NMS; None: the source suppresses by distance.
    """

    source: Literal["openpcdet", "mmdet3d"]
    prefix: str = ""
    grid: Grid
    inputs: PillarInputs
    backbone: BackboneSpec
    plain_up: bool
    backbone_eps: float = 1e-3
    neck_eps: float = 1e-3
    head: AnchorHead | CentreHead
    frame: Frame
    suppression_iou: float | None
