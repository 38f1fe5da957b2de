"""A network grown from a small one computes the same function, and training separates its duplicates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from shift3d.detectors.base import BevWindow
from shift3d.detectors.models.sst import SST_SMALL_SPEC, SST_SPEC, SstNet, SstSpec
from shift3d.detectors.models.window_transformer import TransformerSpec
from shift3d.training.detector.recipes import RECIPES
from shift3d.training.detector.warm_start import doubled, grown

SMALL = SstSpec(TransformerSpec(width=16, heads=2, feed_forward=24, blocks=2), encoder_hidden=6, out_channels=20)
WINDOW = BevWindow(200, 200, 32, 32, 200, 200, 32, 32)


def _trained(spec: SstSpec) -> SstNet:
    """Return a network with different values in every tensor: norms too, as after a training."""
    torch.manual_seed(1)
    net = SstNet(spec)
    for name, tensor in net.state_dict().items():
        if name.endswith("running_var"):
            tensor.uniform_(0.5, 2.0)
        elif ("norm" in name and tensor.is_floating_point()) or (tensor.dim() == 1 and tensor.is_floating_point()):
            tensor.add_(0.3 * torch.randn_like(tensor))
    return net.eval()


def _points() -> torch.Tensor:
    rng = np.random.default_rng(2)
    return torch.from_numpy(rng.uniform((-10.5, -10.5, -1.5), (-1.0, -1.0, 1.5), (3000, 3)).astype(np.float32))


def _outputs(net: SstNet) -> torch.Tensor:
    with torch.no_grad():
        features = net.features([_points()], [WINDOW])
        logits, rows = net.heads.logits(features), net.heads.box_rows(features)
    return torch.cat((logits.view(1, -1, net.heads.per_cell), rows), dim=-1)


def test_the_published_size_is_twice_the_small_one() -> None:
    assert doubled(SST_SMALL_SPEC, "sst") == SST_SPEC
    assert RECIPES["sst"].grown_from == "sst_small" and RECIPES["sst_small"].network == SST_SMALL_SPEC
    with pytest.raises(ValueError, match="not twice"):
        grown({}, SMALL, SST_SPEC)


def test_without_its_new_layers_it_computes_what_the_small_one_does() -> None:
    small, spec = _trained(SMALL), doubled(SMALL, "sst")
    large = SstNet(spec)
    large.load_state_dict(grown(small.state_dict(), SMALL, spec))
    wanted, whole = _outputs(small), _outputs(large.eval())
    layers = large.transformer.layers
    large.transformer.layers = nn.ModuleList(layer for index, layer in enumerate(layers) if index % 4 < 2)
    large.transformer.spec = replace(spec.transformer, blocks=SMALL.transformer.blocks)
    assert wanted.abs().max() > 0.5
    assert torch.allclose(_outputs(large), wanted, atol=1e-4)
    # With norms it is off by the change of a norm that replaces the identity.
    assert 1e-4 < (whole - wanted).abs().max() < 0.5 * wanted.std()


def test_duplicates_part_in_the_first_step() -> None:
    spec = doubled(SMALL, "sst")
    large = SstNet(spec).train()
    large.load_state_dict(grown(_trained(SMALL).state_dict(), SMALL, spec))
    features = large.features([_points()], [WINDOW])
    (large.heads.logits(features).square().mean() + large.heads.box_rows(features).square().mean()).backward()
    gradient = large.dense[0].weight.grad
    assert gradient is not None
    assert not torch.allclose(gradient[0::2], gradient[1::2], rtol=1e-2, atol=0.0)
    for layer in large.transformer.layers:
        assert layer.narrow.weight.grad.abs().max() > 0, "a new layer that adds nothing must be able to learn"
