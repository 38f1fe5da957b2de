"""Linearization of the field at each hit, to first order in position and latent code, for gradients and predictions.

At the field and the positions that it was made at, the linear model is 0 and has the exact derivatives of g by pose and
code: the implicit gradient (see `implicit`). At the code and pose of the next step, the model predicts the change of g,
and so the range at which the beam meets the surface. Attacks descend in small steps: most hits are found within half a
millimetre of the prediction (see `corrector`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from shift3d.render.culling import Rays, take
from shift3d.render.field.object_field import ObjectField
from shift3d.sdf.field import Field as DecoderField


@dataclass(frozen=True)
class Linearization:
    """The linearized field at M positions on beams. All tensors but `graph` are constants.

    Attributes:
        index: (M,) beams, ascending. range_m: (M,) float64 ranges of the positions.
        x_object: (M, 3) float64 positions. g: (M,) float64 metric distance. gradient: (M, 3) float64 gradient of g.
        at_bias: layer to (M, width) derivative of g by the decoder's bias through which the code enters, metres.
        biases: layer to (width,) value of that bias.
        graph: (M,) g with its autograd graph to the code, for fields that are not a decoder's; None otherwise.
    """

    index: Tensor
    range_m: Tensor
    x_object: Tensor
    g: Tensor
    gradient: Tensor
    at_bias: dict[int, Tensor]
    biases: dict[int, Tensor]
    graph: Tensor | None = None

    def __len__(self) -> int:
        return len(self.index)

    def select(self, rows: Tensor) -> Linearization:
        """Select positions by row number or by mask."""
        return self._of(take(self._parts(), rows), self._graph_of(lambda graph: graph[rows]))

    def joined(self, other: Linearization) -> Linearization:
        """Merge with another linearization of the same field, in the order of the beams."""
        if len(other) == 0 or len(self) == 0:
            return self if len(other) == 0 else other
        order, theirs = torch.argsort(torch.cat((self.index, other.index))), other.graph
        parts = take((torch.cat(pair) for pair in zip(self._parts(), other._parts(), strict=True)), order)
        graph = None if theirs is None else self._graph_of(lambda graph: torch.cat((graph, theirs))[order])
        return self._of(parts, graph)

    def _parts(self) -> tuple[Tensor, ...]:
        return (self.index, self.range_m, self.x_object, self.g, self.gradient, *self.at_bias.values())

    def _of(self, parts: Iterable[Tensor], graph: Tensor | None) -> Linearization:
        """Return a linearization of the same field from other `_parts`."""
        index, range_m, x_object, g, gradient, *at_bias = parts
        by_layer = dict(zip(self.at_bias, at_bias, strict=True))
        return Linearization(index, range_m, x_object, g, gradient, by_layer, self.biases, graph)

    def _graph_of(self, part: Callable[[Tensor], Tensor]) -> Tensor | None:
        """Apply `part` to the graph with gradients enabled: under no_grad the path to the code would be lost."""
        if self.graph is None:
            return None
        with torch.enable_grad():
            return part(self.graph)

    def without_graph(self) -> Linearization:
        """Return the same as constants; then a field that is no decoder's has no derivative by the code."""
        return replace(self, graph=None)

    def change(self, field: ObjectField, x_object: Tensor) -> Tensor:
        """Compute the change of g, (M,) float64, if positions move to x_object (M, 3) and the field becomes `field`.

        Differentiable w.r.t. x_object and whatever the biases of `field` depend on; exactly 0 if nothing changed.
        """
        change = ((x_object - self.x_object) * self.gradient).sum(-1)
        if isinstance(field.sdf, DecoderField):
            for layer, part in self.at_bias.items():
                change = change + (part @ (field.sdf.biases[layer] - self.biases[layer])).double()
        if self.graph is not None:
            change = change + (self.graph - self.graph.detach()).double()
        return change


def linearize(field: ObjectField, rays: Rays, k: Tensor) -> Linearization:
    """Linearize the field at ranges k (M,) of M rays, as eqs. dl_dz to theta_final of SHIFT3D need it.

    Costs two evaluations a position, counted as one. Has derivatives by the code only if the code requires a gradient.
    """
    x_object = rays.at(k)
    if not len(rays) or not isinstance(field.sdf, DecoderField):
        with torch.enable_grad():
            with_code = field.depends_on_code()
            leaf = x_object.detach().requires_grad_()
            graph = field(leaf)
            (gradient,) = torch.autograd.grad(graph.sum(), leaf, retain_graph=with_code)
        g = graph.detach().double()
        return Linearization(rays.index, k, x_object, g, gradient, {}, {}, graph if with_code else None)
    sdf, layers = field.sdf, field.sdf.code_layers
    parts = [sdf.tangent(x, layers) for x in field.to_sdf(x_object).split(field.batch)]
    field.count.evaluations += len(x_object)
    g = torch.cat([part.value for part in parts]).double() * field.scale_m
    gradient = torch.cat([part.at_point for part in parts]).double() @ field.sdf_R_object
    at_bias = {
        layer: torch.cat([part.at_bias[number] for part in parts]) * field.scale_m
        for number, layer in enumerate(layers)
    }
    biases = {layer: sdf.biases[layer].detach() for layer in layers}
    return Linearization(rays.index, k, x_object, g, gradient, at_bias, biases)
