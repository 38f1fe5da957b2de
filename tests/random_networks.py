"""Networks with random weights and a random scene: what must hold whatever the weights."""

import torch

from shift3d.detectors.backbone import BackboneSpec
from shift3d.detectors.network import AnchorNet
from shift3d.detectors.pointpillars import PointPillarsNet
from shift3d.detectors.sst import SstNet, SstSpec
from shift3d.detectors.window_transformer import TransformerSpec

SLIM = {
    "pointpillars": BackboneSpec(in_channels=8, channels=(8, 8, 8), up_channels=8),
    "sst": SstSpec(TransformerSpec(width=16, heads=2, feed_forward=32, blocks=2), encoder_hidden=8, out_channels=24),
}


def random_net(name: str, seed: int = 0) -> AnchorNet:
    """Random weights with lively batch-norm statistics and logits of order one."""
    torch.manual_seed(seed)
    spec = SLIM[name]
    net = SstNet(spec) if isinstance(spec, SstSpec) else PointPillarsNet(spec)
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            torch.nn.init.normal_(module.running_mean, std=0.1)
            torch.nn.init.uniform_(module.running_var, 0.5, 1.5)
            torch.nn.init.normal_(module.bias, std=0.1)
        elif isinstance(module, torch.nn.Conv2d | torch.nn.ConvTranspose2d):
            torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")  # signal in every layer
    torch.nn.init.normal_(net.heads.classes.weight, std=0.3)
    torch.nn.init.zeros_(net.heads.classes.bias)
    return net.eval()


def random_scene(count: int = 20000, seed: int = 0) -> torch.Tensor:
    """(count, 3) float32 points all over the grid, network frame."""
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(count, 3, generator=generator) - 0.5) * torch.tensor([152.0, 152.0, 4.0])
    return points + torch.tensor([0.0, 0.0, 1.0])
