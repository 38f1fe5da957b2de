"""What a foreign model is, in plain values: all that its config decides, and nothing of how that config is written.

A layout is made once, where a sweep is planned. It travels to the workers and enters the task ids, not the config.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

from shift3d.detectors.grid import Grid
from shift3d.detectors.models.backbone import BackboneSpec


class _Values(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PillarInputs(_Values):
    """What the pillar network reads of a point, and its layers.

    position: how the point's place is given first: its coordinates, its offset to the pillar's centre, or not at all.
    constants: what stands in for channels beside coordinates. middle_m: height of the pillar's centre.
    slots: points that the source keeps a pillar; in a pillar with fewer, one point of zeros takes part. None: any.
    filters: what each layer hands on: of all but the last, half is a point's own and half its pillar's maximum. named:
    how the source names the layers.
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
        """Values a point."""
        return (0 if self.position == "none" else 3) + len(self.constants) + 6


class Anchor(_Values):
    """One of the anchors of a cell, metres and radians, frame of the model. z_m: of its centre.

    x_m, y_m: of the first and of the last column and line; those between are evenly spaced.
    """

    size_m: tuple[float, float, float]
    heading_rad: float
    z_m: float
    x_m: tuple[float, float]
    y_m: tuple[float, float]


class AnchorHead(_Values):
    """1x1 convolutions. classes: of each anchor; vehicle: the one that is kept. code_size: values of a box, from 7."""

    kind: Literal["anchors"] = "anchors"
    anchors: tuple[Anchor, ...]
    classes: int
    vehicle: int
    code_size: int
    direction_offset_rad: float


class Branch(_Values):
    """A stack of 3x3 convolutions behind the shared one, by the source's name."""

    name: str
    outputs: int
    layers: int


class CentreHead(_Values):
    """A shared 3x3 convolution, and branches for each task.

    tasks: number of classes of each; task, vehicle: where the kept one is. branches: of boxes, in the source's order;
    the first four are offset, height, size, turn. heat: the heat map's name and layers. sine_first: order of the turn.
    hidden: channels within a branch. biased: convolutions before a norm have a bias.
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
    """The model's frame against the network frame, whose origin is on the ground and whose x points forward.

    height_m: of the model's origin above the ground. turned: its x points right and its y forward, as nuScenes has it.
    """

    height_m: float
    turned: bool


class Layout(_Values):
    """A whole model.

    source: whose names the tensors have. prefix: before the names of mmdetection3d's parts. suppression_iou: of the
    source's own suppression; None: it goes by distance. plain_up: upsampling by 1 is an ordinary convolution.
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
