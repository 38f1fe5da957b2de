"""DeepSDF decoder g(z, x), its folded form for one latent code, and its file format.

Source: SHIFT3D section "Object Representation using DeepSDF Model"; Park et al. 2019 for the architecture: eight
hidden layers of 512, the input (z, x) repeated at layer 4, weight norm, ReLU, tanh at the end. The published training
drops activations with probability 0.2. This decoder has no dropout: dropout pays off over thousands of epochs, while
in a short training only its noise shows.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrizations

from shift3d.errors import InputError
from shift3d.sdf.field import Field
from shift3d.sdf.tensors import check_magnitude, checked_tensors, without_subnormals
from shift3d.store.arrays import read_safetensors, write_safetensors

CODE_LENGTH = 256
DEFAULT_WEIGHTS = Path(__file__).parent.parent / "weights" / "sdf.safetensors"


@dataclass(frozen=True)
class Architecture:
    """Layer sizes of a decoder; the defaults are the published ones."""

    code_length: int = CODE_LENGTH
    width: int = 512
    hidden_layers: int = 8
    skip_layer: int = 4

    def sizes(self) -> list[tuple[int, int]]:
        """Return (inputs, outputs) of every linear layer; the layer before the skip leaves room for (z, x)."""
        entry = self.code_length + 3
        sizes = []
        for layer in range(self.hidden_layers + 1):
            inputs = entry if layer == 0 else self.width
            outputs = 1 if layer == self.hidden_layers else self.width
            sizes.append((inputs, outputs - entry if layer + 1 == self.skip_layer else outputs))
        return sizes

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shapes of a folded decoder's tensors, by name."""
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (inputs, outputs) in enumerate(self.sizes()):
            shapes |= {f"layers.{layer}.weight": (outputs, inputs), f"layers.{layer}.bias": (outputs,)}
        return shapes

    def is_valid(self) -> bool:
        """True if the sizes describe a network: integers, a skip between two layers, and enough width for the skip."""
        if any(type(size) is not int for size in vars(self).values()):
            return False
        return self.code_length >= 1 and 1 <= self.skip_layer < self.hidden_layers and self.width > self.code_length + 3


def parameters_of(layer: nn.Module) -> tuple[Tensor, Tensor]:
    """Return weight and bias of a linear layer."""
    weight, bias = layer.weight, layer.bias
    assert isinstance(weight, Tensor)
    assert isinstance(bias, Tensor)
    return weight, bias


class Decoder(nn.Module):
    """DeepSDF decoder as published, weight norm included; `field` returns the fast form for one code."""

    def __init__(self, architecture: Architecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or Architecture()
        self.layers = nn.ModuleList(
            parametrizations.weight_norm(nn.Linear(inputs, outputs)) for inputs, outputs in self.architecture.sizes()
        )

    def forward(self, z: Tensor, x_sdf: Tensor) -> Tensor:
        """Evaluate codes (N, code) and points (N, 3), sdf frame -> signed distances (N,), sdf units.

        Differentiable w.r.t. z, x_sdf and the parameters. Source: Park et al. 2019, section 4 and its supplement.
        """
        entry = torch.cat([z, x_sdf], dim=1)
        hidden = entry
        for index, layer in enumerate(self.layers):
            if index == self.architecture.skip_layer:
                hidden = torch.cat([hidden, entry], dim=1)
            hidden = layer(hidden)
            if index < self.architecture.hidden_layers:
                hidden = torch.relu(hidden)
        return torch.tanh(hidden[:, 0])

    def grouped(self, codes: Tensor, points: Tensor, compute_dtype: torch.dtype = torch.float32) -> Tensor:
        """Evaluate as `forward`, for codes (S, code) with P points each (S, P, 3), sdf frame -> (S, P), codes' dtype.

        Products with z are computed once per shape instead of once per point. Products with the point use the codes'
        dtype: a bfloat16 coordinate alone would be off by millimetres. The wide layers use `compute_dtype`.
        Differentiable w.r.t. codes, points and the parameters.
        """
        shapes, count, _ = points.shape
        x = points.reshape(shapes * count, 3)
        hidden = x
        for index, layer in enumerate(self.layers):
            weight, bias = parameters_of(layer)
            if index in (0, self.architecture.skip_layer):
                before, at_z, at_x = self._split(index, weight)
                entry = (codes @ at_z.T + bias)[:, None] + (x @ at_x.T).reshape(shapes, count, -1)
                mixed = entry.reshape(shapes * count, -1).to(compute_dtype)
                hidden = mixed if before is None else mixed + hidden @ before.to(compute_dtype).T
            elif index == self.architecture.hidden_layers:
                hidden = nn.functional.linear(hidden.to(codes.dtype), weight, bias)
            else:
                hidden = nn.functional.linear(hidden, weight.to(compute_dtype), bias.to(compute_dtype))
            if index < self.architecture.hidden_layers:
                hidden = torch.relu(hidden)
        return torch.tanh(hidden[:, 0]).reshape(shapes, count)

    def field(self, z: Tensor) -> Field:
        """Return the field of one code (code,), differentiable w.r.t. z. Cheap; call again after every change of z.

        Raises: InputError for a code of another length or with values that are not finite.
        """
        if z.shape != (self.architecture.code_length,):
            raise InputError(f"shape {tuple(z.shape)}", "latent code", f"Give {self.architecture.code_length} values")
        if not bool(torch.isfinite(z).all()):
            raise InputError("values that are not finite", where="latent code", remedy="Give a finite code")
        weights, biases = [], []
        for index, layer in enumerate(self.layers):
            weight, bias = parameters_of(layer)
            if index in (0, self.architecture.skip_layer):
                before, at_z, at_x = self._split(index, weight)
                bias = bias + at_z @ z.to(weight.dtype)
                weight = at_x if before is None else torch.cat([before, at_x], dim=1)
            weights.append(weight.contiguous())
            biases.append(bias)
        return Field(weights, biases, self.architecture.skip_layer)

    def _split(self, index: int, weight: Tensor) -> tuple[Tensor | None, Tensor, Tensor]:
        entry = self.architecture.code_length + 3
        before = None if index == 0 else weight[:, :-entry]
        return before, weight[:, -entry:-3], weight[:, -3:]

    def folded(self) -> Decoder:
        """Fold weight norm into plain weights, in place, and return self: faster, but not trainable as published."""
        for layer in self.layers:
            if hasattr(layer, "parametrizations"):
                nn.utils.parametrize.remove_parametrizations(layer, "weight")
        return self

    def with_code_scale(self, factor: float) -> Decoder:
        """Rescale to codes `factor` times as long, in place, and return self: the same shapes up to rounding.

        Folded decoders only. Code scaling keeps all shapes, but scales the shape change per gradient step by factor^-2.
        """
        with torch.no_grad():
            for index in (0, self.architecture.skip_layer):
                weight, _ = parameters_of(self.layers[index])
                self._split(index, weight)[1].div_(factor)
        return self


def save_decoder(decoder: Decoder, path: Path, metadata: dict[str, str] | None = None) -> None:
    """Write the decoder's folded float32 weights to a safetensors file. Raises: InputError, see `write_safetensors`."""
    tensors = {}
    for index, layer in enumerate(decoder.layers):
        weight, bias = parameters_of(layer)
        tensors[f"layers.{index}.weight"] = without_subnormals(weight.detach().float()).contiguous()
        tensors[f"layers.{index}.bias"] = bias.detach().float().contiguous()
    architecture = json.dumps(vars(decoder.architecture), sort_keys=True)
    write_safetensors(path, tensors, {"architecture": architecture, **(metadata or {})})


def load_decoder(path: Path | str | None = None) -> Decoder:
    """Load a decoder: eval mode, folded float32 weights, requires_grad False. `.double()` converts it to float64.

    Args: path: a safetensors file; default the shipped weights.
    Raises: InputError naming the file and the tensor when it is missing, unreadable or of another shape.
    """
    tensors, metadata, source = read_safetensors(path, DEFAULT_WEIGHTS, "pt")
    return decoder_from_tensors(tensors, _architecture(metadata, len(tensors), str(source)), str(source))


def _architecture(metadata: dict[str, str], tensors: int, where: str) -> Architecture:
    try:
        architecture = Architecture(**json.loads(metadata["architecture"]))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError("no decoder architecture in its metadata", where, "Give a decoder's weights") from error
    # Checked before any allocation of these sizes: they come from the metadata, which the tensors must confirm.
    if not architecture.is_valid() or 2 * (architecture.hidden_layers + 1) != tensors:
        what = f"no decoder with {tensors} tensors is made like {architecture}"
        raise InputError(what, where=where, remedy="Give a decoder's weights")
    return architecture


def decoder_from_tensors(tensors: dict[str, torch.Tensor], architecture: Architecture, where: str) -> Decoder:
    """Build a folded float32 decoder from tensors named `layers.<i>.weight|bias`.

    Raises: InputError naming the tensor that is missing, surplus, of another shape or kind, or not finite; also for
        weights so large that values would overflow.
    """
    tensors = checked_tensors(tensors, architecture.shapes(), where)
    entry, layers = architecture.code_length + 3, range(architecture.hidden_layers + 1)
    check_magnitude(tensors, [entry if layer in (0, architecture.skip_layer) else 0 for layer in layers], {}, where)
    decoder = Decoder(architecture).folded()
    decoder.load_state_dict(tensors)
    return decoder.eval().requires_grad_(False)
