"""Network of the original DeepSDF repository: every variant that its specs.json can describe.

Source: networks/deep_sdf_decoder.py of the original repository, also for facts missing from its comments: `latent_in`
wins over `xyz_in_all` at the same layer; a layer norm precedes the ReLU, exists only without weight norm and never
after the last layer; the output goes through tanh, and through a second tanh with `use_tanh`. Dropout is for training
only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor, nn

from shift3d.errors import InputError
from shift3d.sdf.field import Field


@dataclass(frozen=True)
class NetworkSpecs:
    """CodeLength and the entries of NetworkSpecs that affect a trained network's values, named as in specs.json."""

    code_length: int
    dims: tuple[int, ...]
    norm_layers: tuple[int, ...] = ()
    latent_in: tuple[int, ...] = ()
    weight_norm: bool = False
    xyz_in_all: bool = False
    use_tanh: bool = False

    @property
    def layers(self) -> int:
        """Number of linear layers: hidden layers plus one."""
        return len(self.dims) + 1

    def entry(self, layer: int) -> int:
        """Return the number of inputs of a layer beside the previous layer: of z and x, of x (3), or 0."""
        if layer == 0 or layer in self.latent_in:
            return self.code_length + 3
        return 3 if self.xyz_in_all else 0

    def reads_code(self, layer: int) -> bool:
        """True if z and x are inputs of a layer."""
        return self.entry(layer) > 3

    def size(self, layer: int) -> tuple[int, int]:
        """Return (inputs, outputs) of a linear layer; outputs leave room for the next layer's additional inputs."""
        widths = (self.code_length + 3, *self.dims, 1)
        room = self.entry(layer + 1) if layer + 1 < self.layers or layer + 1 in self.latent_in else 0
        return widths[layer], widths[layer + 1] - room

    def normed(self, layer: int) -> bool:
        """True if the network has a layer norm `bn<layer>`."""
        return not self.weight_norm and layer in self.norm_layers

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of a `DeepSdfNetwork`'s tensors, by name."""
        shapes: dict[str, tuple[int, ...]] = {}
        for layer in range(self.layers):
            inputs, outputs = self.size(layer)
            shapes |= {f"layers.{layer}.weight": (outputs, inputs), f"layers.{layer}.bias": (outputs,)}
            if self.normed(layer):
                shapes |= {f"norms.{layer}.weight": (outputs,), f"norms.{layer}.bias": (outputs,)}
        return shapes


@dataclass(frozen=True)
class DeepSdfField:
    """g(z, .) of one code; terms that depend on z alone are computed once. Differentiable like `Field`."""

    specs: NetworkSpecs
    weights: list[Tensor]
    biases: list[Tensor]
    norms: dict[int, nn.Module]

    def __call__(self, x_sdf: Tensor) -> Tensor:
        """Compute the signed distance (N,), sdf units, at points (N, 3), cast to the weights' dtype."""
        x = x_sdf.to(self.weights[0].dtype)
        hidden = x
        last = self.specs.layers - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer and self.specs.entry(layer):
                hidden = torch.cat([hidden, x], dim=1)
            hidden = torch.addmm(bias, hidden, weight.T)
            if layer < last:
                hidden = torch.relu(self.norms[layer](hidden) if layer in self.norms else hidden)
        value = torch.tanh(hidden[:, 0])
        return torch.tanh(value) if self.specs.use_tanh else value


class DeepSdfNetwork(nn.Module):
    """DeepSDF network with folded weight norm; `field` evaluates it for one code. `Decoder` is the published form."""

    def __init__(self, specs: NetworkSpecs) -> None:
        super().__init__()
        self.specs = specs
        self.layers = nn.ModuleList(nn.Linear(*specs.size(layer)) for layer in range(specs.layers))
        self.norms = nn.ModuleDict(
            {str(layer): nn.LayerNorm(specs.size(layer)[1]) for layer in range(specs.layers) if specs.normed(layer)}
        )

    def forward(self, z: Tensor, x_sdf: Tensor) -> Tensor:
        """Evaluate codes (N, code) at points (N, 3), sdf frame -> signed distances (N,), sdf units: the plain form.

        Differentiable w.r.t. z, x_sdf and the parameters. Source: Park et al. 2019, section 4 and its supplement.
        """
        entry = torch.cat([z, x_sdf], dim=1)
        hidden = entry
        for layer, linear in enumerate(self.layers):
            if layer and (more := self.specs.entry(layer)):
                hidden = torch.cat([hidden, entry[:, -more:]], dim=1)
            hidden = linear(hidden)
            if layer < self.specs.layers - 1:
                hidden = torch.relu(self.norms[str(layer)](hidden) if self.specs.normed(layer) else hidden)
        value = torch.tanh(hidden[:, 0])
        return torch.tanh(value) if self.specs.use_tanh else value

    def field(self, z: Tensor) -> DeepSdfField | Field:
        """Return the field of one code (code,), differentiable w.r.t. z. Cheap; call again after every change of z.

        Raises: InputError for a code of another length or with values that are not finite.
        """
        norms = {int(layer): norm for layer, norm in self.norms.items() if int(layer) < self.specs.layers - 1}
        return DeepSdfField(self.specs, *self._folded_for(z), norms)

    def with_code_scale(self, factor: float) -> Self:
        """Rescale to codes `factor` times as long, in place, and return self: the same shapes up to rounding.

        Folded weights only. Code scaling keeps all shapes, but scales the shape change per gradient step by factor^-2.
        """
        with torch.no_grad():
            for index, layer in enumerate(self.layers):
                if self.specs.reads_code(index):
                    self._split(parameters_of(layer)[0])[1].div_(factor)
        return self

    def _folded_for(self, z: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Return weights and biases for one code: biases hold the terms of z, weights lack its columns."""
        if z.shape != (self.specs.code_length,):
            raise InputError(f"shape {tuple(z.shape)}", "latent code", f"Give {self.specs.code_length} values")
        if not bool(torch.isfinite(z).all()):
            raise InputError("values that are not finite", where="latent code", remedy="Give a finite code")
        weights, biases = [], []
        for index, layer in enumerate(self.layers):
            weight, bias = parameters_of(layer)
            if self.specs.reads_code(index):
                before, at_z, at_x = self._split(weight)
                bias = bias + at_z @ z.to(weight.dtype)
                weight = torch.cat([before, at_x], dim=1)
            weights.append(weight)
            biases.append(bias)
        return weights, biases

    def _split(self, weight: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the columns of the previous layer, of z and of x; only for a layer that reads the code."""
        entry = self.specs.code_length + 3
        return weight[:, :-entry], weight[:, -entry:-3], weight[:, -3:]


def parameters_of(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Return weight and bias of a linear layer."""
    weight, bias = layer.weight, layer.bias
    assert isinstance(weight, Tensor)
    assert isinstance(bias, Tensor)
    return weight, bias
