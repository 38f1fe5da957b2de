"""Training objective of heads without anchors: a heat map with a peak at every centre, and boxes near the peak."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import torch
import torch.nn.functional as functional
from torch import Tensor

from shift3d.detectors.base import BevWindow
from shift3d.detectors.grid import Grid
from shift3d.detectors.models.centre_heads import encode_centres
from shift3d.detectors.models.network import BoxHeads
from shift3d.training.detector.crops import Crop
from shift3d.training.detector.recipe import Recipe

HEAT_BETA, HEAT_GAMMA = 4.0, 2.0
LEAST_OVERLAP = 0.1
LEAST_RADIUS = 2


@dataclass(frozen=True)
class CentreTargets:
    """Targets: heat (cells,) in [0, 1]; trained (cells,) bool; positives (P,) int64, cell indices; codes (P, 8)."""

    heat: Tensor
    trained: Tensor
    positives: Tensor
    codes: Tensor


def gaussian_radius(length: float, width: float) -> int:
    """Compute the shift in x and y, in cells, at which a footprint overlaps itself with an IoU of LEAST_OVERLAP.

    Solves (l - r)(w - r) = 2 m / (1 + m) l w. Source: CornerNet, section 3.2; CenterPoint: overlap 0.1, at least 2.
    """
    total, part = length + width, length * width * (1.0 - LEAST_OVERLAP) / (1.0 + LEAST_OVERLAP)
    return max(LEAST_RADIUS, int((total - sqrt(max(0.0, total**2 - 4.0 * part))) / 2.0))


def assign_centres(grid: Grid, window: BevWindow, boxes: Tensor, usable: Tensor, centre_radius: int) -> CentreTargets:
    """Compute the targets of the window's cells (x varies fastest) from vehicles (M, 7).

    usable: (M,) bool; cells around the centres of the other vehicles (too few points) are not trained. centre_radius:
    cells around a centre that also regress its box, so that a peak one cell off still gives the box; a cell of two
    vehicles belongs to the nearer one. Source: CenterPoint, section 4.1; more than one cell: AFDet (Ge et al. 2020).
    """
    y, x = torch.meshgrid(torch.arange(window.num_y), torch.arange(window.num_x), indexing="ij")
    heat, trained = torch.zeros(x.shape), torch.ones(x.shape, dtype=torch.bool)
    nearest = torch.full(heat.shape, float("inf"))
    owner = torch.full(heat.shape, -1)
    for row, box in enumerate(boxes.double()):
        at_x = (float(box[0]) - grid.x_min_m) / grid.cell_m - window.x0
        at_y = (float(box[1]) - grid.y_min_m) / grid.cell_m - window.y0
        radius = gaussian_radius(float(box[3]) / grid.cell_m, float(box[4]) / grid.cell_m)
        away_x, away_y = (x - int(at_x // 1)).abs(), (y - int(at_y // 1)).abs()
        around = torch.maximum(away_x, away_y) <= radius
        if not bool(around.any()):
            continue
        if not bool(usable[row]):
            trained &= ~around
            continue
        bell = torch.exp(-(away_x**2 + away_y**2) / (2.0 * ((2 * radius + 1) / 6.0) ** 2))
        heat = torch.where(around, torch.maximum(heat, bell), heat)
        distance = torch.hypot(x + 0.5 - at_x, y + 0.5 - at_y)
        mine = (torch.maximum(away_x, away_y) <= centre_radius) & (distance < nearest)
        nearest, owner = torch.where(mine, distance, nearest), torch.where(mine, row, owner)
    positives = torch.nonzero(((owner >= 0) & trained).reshape(-1)).squeeze(1)
    cells = torch.stack((positives % window.num_x + window.x0, positives // window.num_x + window.y0), dim=1)
    codes = encode_centres(boxes[owner.reshape(-1)[positives]], cells, grid)
    return CentreTargets(heat.reshape(-1), trained.reshape(-1), positives, codes)


def heat_map_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """Compute each cell's loss against its heat in [0, 1], same shape. Heat 1 is a centre; near it a score costs less.

    Differentiable w.r.t. logits. Source: CornerNet (Law and Deng 2018), equation 1, as in CenterPoint.
    """
    wrong = torch.sigmoid(torch.where(heat == 1.0, -logits, logits))
    cross_entropy = functional.softplus(torch.where(heat == 1.0, -logits, logits))
    return (1.0 - heat).pow(HEAT_BETA).masked_fill(heat == 1.0, 1.0) * wrong**HEAT_GAMMA * cross_entropy


class CentreObjective:
    """Focal loss of the heat map over the number of centres, L1 loss of boxes over the number of positives.

    Source: CenterPoint, with the weights of its public Waymo configuration (box 2).
    """

    def __init__(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self.weights = torch.tensor((*recipe.code_weights, recipe.code_weights[6]))

    def targets(self, heads: BoxHeads, grid: Grid, crop: Crop) -> CentreTargets:
        """Compute the targets of one crop."""
        boxes, usable = torch.from_numpy(crop.boxes), torch.from_numpy(crop.usable)
        return assign_centres(grid, crop.window, boxes, usable, self.recipe.centre_radius)

    def loss(self, logits: Tensor, box_rows: Tensor, target: CentreTargets) -> dict[str, Tensor]:
        """Compute the weighted loss parts. logits: (cells,). box_rows: (P, 8), predicted codes at the positives."""
        centres = ((target.heat == 1.0) & target.trained).sum().clamp_min(1)
        heat = heat_map_loss(logits[target.trained], target.heat[target.trained]).sum() / centres
        difference = (box_rows - target.codes).abs() * self.weights.to(box_rows.device)
        boxes = difference.sum() / max(1, len(target.positives))
        return {"class": heat, "box": self.recipe.box_weight * boxes}

    def cells(self, heads: BoxHeads, target: CentreTargets) -> Tensor:
        """Return the cells (P,) of the positives."""
        return target.positives
