"""Statistics of batch norms, taken once with the final weights, so that training ends on what inference computes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.network import DetectorNet

__all__ = ["recompute_statistics"]


def recompute_statistics(net: DetectorNet, clouds: Sequence[Tensor], windows: Sequence[BevWindow]) -> None:
    """Set every batch norm's mean and variance to those of this batch, in place; weights stay.

    All crops go through as one batch, each layer normalised by that batch: the statistics of a layer are then those
    of what it is given at inference. Means over small batches are not: each of these normalises by its own.
    Source: our choice, after the population statistics of Ioffe and Szegedy 2015, section 3.1; Wu and Johnson 2021
    measure what running means lose.
    """
    norms = [module for module in net.modules() if isinstance(module, nn.BatchNorm1d | nn.BatchNorm2d)]
    momenta = [norm.momentum for norm in norms]
    was_training = net.training
    net.train()
    for norm in norms:
        norm.momentum = 1.0
    with torch.no_grad(), torch.autocast(clouds[0].device.type, enabled=False):
        net.features(clouds, windows)
    for norm, momentum in zip(norms, momenta, strict=True):
        norm.momentum = momentum
    net.train(was_training)
