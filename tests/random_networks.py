"""Networks with random weights and a random scene, for properties that hold for any weights."""

import torch

from shift3d.detectors.models.backbone import BackboneSpec
from shift3d.detectors.models.network import DetectorNet
from shift3d.detectors.models.pillar_detectors import CenterPointNet, PointPillarsNet
from shift3d.detectors.models.sst import SstNet, SstSpec
from shift3d.detectors.models.window_transformer import TransformerSpec
from shift3d.sdf.decoder import Architecture, Decoder

PILLARS = BackboneSpec(in_channels=8, channels=(8, 8, 8), up_channels=8)
SLIM = {
    "pointpillars": PILLARS,
    "centerpoint": PILLARS,
    "sst": SstSpec(TransformerSpec(width=16, heads=2, feed_forward=32, blocks=2), encoder_hidden=8, out_channels=24),
}


def random_net(name: str, seed: int = 0) -> DetectorNet:
    """Return a network with random weights, varied batch-norm statistics and logits of order one."""
    torch.manual_seed(seed)
    spec = SLIM[name]
    pillars = CenterPointNet if name == "centerpoint" else PointPillarsNet
    net = SstNet(spec) if isinstance(spec, SstSpec) else pillars(spec)
    for module in net.modules():
        if isinstance(module, torch.nn.BatchNorm1d | torch.nn.BatchNorm2d):
            torch.nn.init.normal_(module.running_mean, std=0.1)
            torch.nn.init.uniform_(module.running_var, 0.5, 1.5)
            torch.nn.init.normal_(module.bias, std=0.1)
        elif isinstance(module, torch.nn.Conv2d | torch.nn.ConvTranspose2d):
            torch.nn.init.kaiming_normal_(module.weight, nonlinearity="relu")  # signal in every layer
    torch.nn.init.normal_(net.heads.classes.weight, std=0.3 if net.heads.per_cell > 1 else 0.6)
    torch.nn.init.zeros_(net.heads.classes.bias)
    return net.eval()


def random_scene(count: int = 20000, seed: int = 0) -> torch.Tensor:
    """Return (count, 3) float32 points all over the grid, network frame."""
    generator = torch.Generator().manual_seed(seed)
    points = (torch.rand(count, 3, generator=generator) - 0.5) * torch.tensor([152.0, 152.0, 4.0])
    return points + torch.tensor([0.0, 0.0, 1.0])


def random_decoder(seed: int = 0, idle: float = 0.6) -> Decoder:
    """Return a small folded decoder, of whose hidden units a share `idle` is off in most of the unit ball."""
    torch.manual_seed(seed)
    decoder = Decoder(Architecture(code_length=5, width=128, hidden_layers=5, skip_layer=2)).folded()
    with torch.no_grad():
        for layer in decoder.layers[:-1]:
            asleep = torch.rand(len(layer.bias)) < idle
            layer.weight.mul_(1.5)
            layer.bias.copy_(torch.where(asleep, -0.6 - 0.6 * torch.rand(len(layer.bias)), layer.bias))
    return decoder.requires_grad_(False)
