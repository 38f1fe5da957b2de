"""Network of the original DeepSDF repository: every variant that its specs.json can describe.

Source: networks/deep_sdf_decoder.py of the original repository, also for facts missing from its comments: `latent_in`
wins over `xyz_in_all` at the same layer; a layer norm precedes the ReLU, exists only without weight norm and never
after the last layer; the output goes through tanh, and through a second tanh with `use_tanh`. Dropout is for training
only.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from shift3d.errors import InputError
from shift3d.sdf.decoder import Architecture, parameters_of


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

    def entry(self, layer: int) -> str:
        """Return the input of a layer beside the previous layer: "code" (z and x), "point" (x) or "" (nothing)."""
        if layer == 0 or layer in self.latent_in:
            return "code"
        return "point" if self.xyz_in_all else ""

    def size(self, layer: int) -> tuple[int, int]:
        """Return (inputs, outputs) of a linear layer; outputs leave room for the next layer's additional inputs."""
        widths = (self.code_length + 3, *self.dims, 1)
        outputs = widths[layer + 1]
        if layer + 1 in self.latent_in:
            outputs -= widths[0]
        elif self.xyz_in_all and layer + 1 < self.layers:
            outputs -= 3
        return widths[layer], outputs

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

    def entries(self) -> list[int]:
        """Return the number of inputs of each layer beside the previous layer."""
        count = {"code": self.code_length + 3, "point": 3, "": 0}
        return [count[self.entry(layer)] for layer in range(self.layers)]

    def published(self) -> Architecture | None:
        """Return the same network as `Architecture`, None unless one width, one skip, no norm, xyz_in_all, use_tanh."""
        norms = any(self.normed(layer) for layer in range(self.layers - 1))
        kinds = len(set(self.dims)) == 1 and len(self.latent_in) == 1 and not (norms or self.xyz_in_all)
        if not kinds or self.use_tanh or not 0 < self.latent_in[0] < self.layers - 1:
            return None
        return Architecture(self.code_length, self.dims[0], len(self.dims), self.latent_in[0])


@dataclass(frozen=True)
class DeepSdfField:
    """g(z, .) of one code; terms that depend on z alone are computed once. Differentiable like `Field`."""

    specs: NetworkSpecs
    weights: tuple[Tensor, ...]
    biases: tuple[Tensor, ...]
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
    """DeepSDF network with folded weight norm, for the variants that `Decoder` does not support."""

    def __init__(self, specs: NetworkSpecs) -> None:
        super().__init__()
        self.specs = specs
        self.layers = nn.ModuleList(nn.Linear(*specs.size(layer)) for layer in range(specs.layers))
        self.norms = nn.ModuleDict(
            {str(layer): nn.LayerNorm(specs.size(layer)[1]) for layer in range(specs.layers) if specs.normed(layer)}
        )

    def forward(self, z: Tensor, x_sdf: Tensor) -> Tensor:
        """Evaluate codes (N, code) at points (N, 3) -> (N,) sdf units. Differentiable w.r.t. both."""
        entry = torch.cat([z, x_sdf], dim=1)
        hidden = entry
        for layer, linear in enumerate(self.layers):
            extra = self.specs.entry(layer) if layer else ""
            if extra:
                hidden = torch.cat([hidden, entry if extra == "code" else x_sdf], dim=1)
            hidden = linear(hidden)
            if layer < self.specs.layers - 1:
                hidden = torch.relu(self.norms[str(layer)](hidden) if self.specs.normed(layer) else hidden)
        value = torch.tanh(hidden[:, 0])
        return torch.tanh(value) if self.specs.use_tanh else value

    def field(self, z: Tensor) -> DeepSdfField:
        """Return the field of a code (code,), differentiable. Raises: InputError for a wrong length or NaN or inf."""
        if z.shape != (self.specs.code_length,) or not bool(torch.isfinite(z).all()):
            what = f"shape {tuple(z.shape)}, or values that are not finite"
            raise InputError(what, "latent code", f"Give a finite code of shape ({self.specs.code_length},)")
        weights, biases = [], []
        for layer, linear in enumerate(self.layers):
            weight, bias = parameters_of(linear)
            if self.specs.entry(layer) == "code":
                split = weight.shape[1] - self.specs.code_length - 3
                bias = bias + weight[:, split:-3] @ z.to(weight.dtype)
                weight = torch.cat([weight[:, :split], weight[:, -3:]], dim=1)
            weights.append(weight)
            biases.append(bias)
        norms = {int(layer): norm for layer, norm in self.norms.items() if int(layer) < self.specs.layers - 1}
        return DeepSdfField(self.specs, tuple(weights), tuple(biases), norms)

    def with_code_scale(self, factor: float) -> DeepSdfNetwork:
        """Rescale to codes `factor` times as long, in place, and return self: the same shapes up to rounding."""
        with torch.no_grad():
            for layer, linear in enumerate(self.layers):
                if self.specs.entry(layer) == "code":
                    parameters_of(linear)[0][:, -self.specs.code_length - 3 : -3].div_(factor)
        return self
