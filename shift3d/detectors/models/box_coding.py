"""Boxes relative to anchors, as SECOND (Yan et al. 2018, section 3.3) codes them, and direction bins.

All boxes are (x, y, z, dx, dy, dz, heading) with the geometric centre, metres, radians.
"""

from __future__ import annotations

from math import pi

import torch
from torch import Tensor

DIRECTION_OFFSET_RAD = pi / 4
"""Bin 0 is heading in [pi/4, 5 pi/4). Put there so that no bin ends at an anchor's heading. Source: SECOND's
public config."""
MAX_LOG_RATIO = 5.0


def encode_boxes(boxes: Tensor, anchors: Tensor) -> Tensor:
    """(A, 7) boxes against (A, 7) anchors -> (A, 7) codes; the heading's code is the plain difference."""
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    offset_xy = (boxes[:, :2] - anchors[:, :2]) / diagonal.unsqueeze(1)
    offset_z = (boxes[:, 2:3] - anchors[:, 2:3]) / anchors[:, 5:6]
    sizes = torch.log(boxes[:, 3:6] / anchors[:, 3:6])
    return torch.cat((offset_xy, offset_z, sizes, boxes[:, 6:7] - anchors[:, 6:7]), dim=1)


def direction_bins(heading_rad: Tensor) -> Tensor:
    """Which half turn a heading lies in: 0 for [pi/4, 5 pi/4) modulo a turn, else 1. int64, any shape."""
    turned = torch.remainder(heading_rad - DIRECTION_OFFSET_RAD, 2 * pi)
    return (turned >= pi).to(torch.int64)


def decode_boxes(
    codes: Tensor, anchors: Tensor, direction_logits: Tensor, offset_rad: float = DIRECTION_OFFSET_RAD
) -> Tensor:
    """Codes (A, 7), anchors (A, 7), direction logits (A, 2) -> boxes (A, 7), heading in [-pi, pi).

    The sine loss leaves the heading open by half turns: the direction bin decides it, bin 0 from offset_rad on. Size
    codes are clipped at +-5, so that no code can give an infinite box.
    """
    diagonal = torch.hypot(anchors[:, 3], anchors[:, 4])
    centre_xy = codes[:, :2] * diagonal.unsqueeze(1) + anchors[:, :2]
    centre_z = codes[:, 2:3] * anchors[:, 5:6] + anchors[:, 2:3]
    sizes = torch.exp(codes[:, 3:6].clamp(-MAX_LOG_RATIO, MAX_LOG_RATIO)) * anchors[:, 3:6]
    half_turn = torch.remainder(codes[:, 6] + anchors[:, 6] - offset_rad, pi)
    bins = direction_logits.argmax(dim=1).to(codes.dtype)
    heading = half_turn + offset_rad + pi * bins
    heading = torch.remainder(heading + pi, 2 * pi) - pi
    return torch.cat((centre_xy, centre_z, sizes, heading.unsqueeze(1)), dim=1)
