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
from shift3d.sdf.deepsdf_network import DeepSdfNetwork, NetworkSpecs, parameters_of
from shift3d.sdf.field import Field
from shift3d.sdf.tensors import checked_tensors, without_subnormals
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

    def specs(self) -> NetworkSpecs:
        """Return the same network as the original repository describes it."""
        dims = (self.width,) * self.hidden_layers
        return NetworkSpecs(self.code_length, dims, latent_in=(self.skip_layer,), weight_norm=True)

    def is_valid(self) -> bool:
        """True if the sizes describe a network: integers, a skip between two layers, and enough width for the skip."""
        if any(type(size) is not int for size in vars(self).values()):
            return False
        return self.code_length >= 1 and 1 <= self.skip_layer < self.hidden_layers and self.width > self.code_length + 3


class Decoder(DeepSdfNetwork):
    """DeepSDF decoder as published, weight norm included; `field` returns the fast form for one code."""

    def __init__(self, architecture: Architecture | None = None) -> None:
        architecture = architecture or Architecture()
        super().__init__(architecture.specs())
        self.architecture = architecture
        for layer in self.layers:
            parametrizations.weight_norm(layer)

    def grouped(self, codes: Tensor, points: Tensor, compute_dtype: torch.dtype = torch.float32) -> Tensor:
        """Evaluate codes (S, code) at P points each (S, P, 3), sdf frame -> signed distances (S, P), sdf units.

        Products with z are computed once per shape instead of once per point. Products with the point use the codes'
        dtype, that of the result: a bfloat16 coordinate alone would be off by millimetres. The wide layers use
        `compute_dtype`. Differentiable w.r.t. codes, points and the parameters.
        """
        shapes, count, _ = points.shape
        x = points.reshape(shapes * count, 3)
        hidden = x
        for index, layer in enumerate(self.layers):
            weight, bias = parameters_of(layer)
            if self.specs.reads_code(index):
                before, at_z, at_x = self._split(weight)
                entry = (codes @ at_z.T + bias)[:, None] + (x @ at_x.T).reshape(shapes, count, -1)
                mixed = entry.reshape(shapes * count, -1).to(compute_dtype)
                hidden = mixed + hidden @ before.to(compute_dtype).T if index else mixed
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
        return Field(*self._folded_for(z), self.architecture.skip_layer)

    def folded(self) -> Decoder:
        """Fold weight norm into plain weights, in place, and return self: faster, but not trainable as published."""
        for layer in self.layers:
            if hasattr(layer, "parametrizations"):
                nn.utils.parametrize.remove_parametrizations(layer, "weight")
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
    tensors = checked_tensors(tensors, architecture.specs(), where)
    decoder = Decoder(architecture).folded()
    decoder.load_state_dict(tensors)
    return decoder.eval().requires_grad_(False)
