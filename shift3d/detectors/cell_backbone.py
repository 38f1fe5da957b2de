"""PointPillars' backbone and heads evaluated cell by cell: what changed and is needed, and nothing else.

A convolution of chosen cells is a matrix product of their gathered 3x3 neighbourhoods. On one core of the machine at
hand that runs as fast per operation as a dense convolution (75 to 83 GFLOP/s against 55 to 84 in float32), so that
operations saved are time saved, whatever shape the chosen cells have. Activations are kept between calls.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import linear

from shift3d.detectors.backbone import Backbone, Heads
from shift3d.detectors.cell_sets import (
    CellNumbers,
    CellSet,
    MapShape,
    empty_set,
    fine_cells,
    pooled,
    reached,
    sources,
    whole_set,
)
from shift3d.processor import pad_to_bucket

__all__ = ["CellBackbone", "CellCache", "CellTape"]

ROWS_AT_ONCE = 1024
"""Neighbourhoods gathered at once, at most: 9 MB of float32 at 256 channels, which the caches hold."""


@dataclass(frozen=True)
class _Convolution:
    """weight: (c_out, 9 c_in), columns by the kernel's row, its column, the channel. bias: (c_out,)."""

    weight: Tensor
    bias: Tensor
    stride: int


@dataclass(frozen=True)
class _Branch:
    """A block's way to the heads.

    up_weight: (s² u, c), rows by line and column within the cell, then channel; up_bias: (s² u,). heads: (u, h), the
    heads' columns for this branch, in the precision that must be exact.
    """

    last_layer: int
    factor: int
    up_weight: Tensor
    up_bias: Tensor
    heads: Tensor


class CellBackbone:
    """The folded backbone and heads as matrices. Nothing here changes once made; any number of caches share it."""

    def __init__(self, backbone: Backbone, heads: Heads, exact: torch.dtype) -> None:
        """backbone, heads: folded, for inference. exact: dtype of logits and box codes."""
        self.exact = exact
        chain: list[_Convolution] = []
        branches = []
        kinds = (heads.classes, heads.boxes, heads.directions)
        head_rows = torch.cat([kind.weight.flatten(1) for kind in kinds]).detach().to(exact)
        self.head_bias = torch.cat([kind.bias for kind in kinds if kind.bias is not None]).detach().to(exact)
        self.anchors = heads.classes.out_channels
        first = 0
        for block, up, factor in zip(backbone.blocks, backbone.ups, backbone.spec.total_strides, strict=True):
            chain += [_convolution(layer) for layer in block.modules() if isinstance(layer, nn.Conv2d)]
            (layer,) = (part for part in up.modules() if isinstance(part, nn.ConvTranspose2d))
            assert layer.bias is not None
            weight = layer.weight.detach().permute(2, 3, 1, 0).flatten(0, 2)
            columns = head_rows[:, first : first + layer.out_channels]
            bias = layer.bias.detach().repeat(factor**2)
            branches.append(_Branch(len(chain) - 1, factor, weight.contiguous(), bias, columns.t().contiguous()))
            first += layer.out_channels
        self.chain = tuple(chain)
        self.branches = tuple(branches)

    def shapes(self, window: MapShape) -> list[MapShape]:
        """Of the input and of every layer's output."""
        result = [window]
        for layer in self.chain:
            result.append(result[-1].strided(layer.stride))
        return result

    def needed(self, outputs: CellSet) -> list[CellSet]:
        """The cells of the input and of every layer that the features of these output cells depend on."""
        shapes = self.shapes(MapShape(outputs.shape[0] - 2, outputs.shape[1] - 2))
        result = [empty_set(shape) for shape in shapes]
        for branch in self.branches:
            result[branch.last_layer + 1] |= pooled(outputs, branch.factor)
        for index in range(len(self.chain), 0, -1):
            result[index - 1] |= sources(result[index], self.chain[index - 1].stride, shapes[index - 1])
        return result


def _convolution(layer: nn.Conv2d) -> _Convolution:
    assert layer.bias is not None and layer.kernel_size == (3, 3) and layer.padding == (1, 1)
    weight = layer.weight.detach().permute(0, 2, 3, 1).flatten(1).contiguous()
    return _Convolution(weight, layer.bias.detach(), layer.stride[0])


class CellCache:
    """Activations of one window, recomputed where they changed and are needed.

    canvas: (rows, C) pillar features by cell number, the backbone's dtype; the caller writes them.
    """

    def __init__(self, net: CellBackbone, window: MapShape) -> None:
        self.net = net
        self.shapes = net.shapes(window)
        widths = [net.chain[0].weight.shape[1] // 9, *(layer.weight.shape[0] for layer in net.chain)]
        # Zeros that are never written take no memory: pages come with the first write.
        self._activations = [
            net.chain[0].weight.new_zeros(shape.rows, width) for shape, width in zip(self.shapes, widths, strict=True)
        ]
        self._up_active = []
        self._head_parts = []
        for branch in net.branches:
            rows, (channels, outputs) = self.shapes[branch.last_layer + 1].rows, branch.heads.shape
            self._up_active.append(torch.zeros(rows, branch.factor**2 * channels, dtype=torch.bool))
            self._head_parts.append(branch.heads.new_zeros(rows, branch.factor**2 * outputs))
        # What changed since it was computed: at first, everything.
        self._stale = [whole_set(shape) for shape in self.shapes]
        self._stale_heads = [whole_set(self.shapes[branch.last_layer + 1]) for branch in net.branches]

    @property
    def canvas(self) -> Tensor:
        return self._activations[0]

    def due(self, changed: CellSet, needed: CellSet) -> CellSet:
        """The input cells to be written before `advance`: changed now or earlier, and needed.

        What is changed and not needed is kept in mind until it is.
        """
        due, self._stale[0] = _split(changed | self._stale[0], needed)
        return due

    def advance(self, written: CellSet, needed: list[CellSet], outputs: CellSet) -> None:
        """Carry the cells of the canvas that were written to everything that is needed.

        needed: `CellBackbone.needed` of the output cells `outputs`. Not differentiable: see `CellTape`.
        """
        changed = written
        for index, layer in enumerate(self.net.chain):
            reach = reached(changed, layer.stride) | self._stale[index + 1]
            changed, self._stale[index + 1] = _split(reach, needed[index + 1])
            self._convolve(index, np.flatnonzero(changed))
            for number, branch in enumerate(self.net.branches):
                if branch.last_layer == index:
                    wanted = pooled(outputs, branch.factor)
                    due, self._stale_heads[number] = _split(changed | self._stale_heads[number], wanted)
                    self._upsample(number, np.flatnonzero(due))

    def _convolve(self, index: int, cells: CellNumbers) -> None:
        layer, source, target = self.net.chain[index], self._activations[index], self._activations[index + 1]
        for part in _batches(cells, layer.weight.dtype):
            neighbours = torch.from_numpy(self.shapes[index].neighbours(part, layer.stride).reshape(-1))
            gathered = source.index_select(0, neighbours).view(len(part), -1)
            target.index_copy_(0, torch.from_numpy(part), linear(gathered, layer.weight, layer.bias).relu_())

    def _upsample(self, number: int, cells: CellNumbers) -> None:
        branch = self.net.branches[number]
        channels = branch.heads.shape[0]
        for part in _batches(cells, branch.up_weight.dtype):
            rows = torch.from_numpy(part)
            source = self._activations[branch.last_layer + 1].index_select(0, rows)
            features = linear(source, branch.up_weight, branch.up_bias).relu_()
            parts = features.view(-1, channels).to(branch.heads.dtype) @ branch.heads
            self._head_parts[number].index_copy_(0, rows, parts.view(len(rows), -1))
            self._up_active[number].index_copy_(0, rows, features > 0)

    def heads(self, core: tuple[int, int, int, int]) -> Tensor:
        """(h, w, H): the heads' outputs of the core (y0, x0, height, width), aligned to the stride; exact dtype.

        H: class logits, then box codes, then direction logits of the cell's anchors.
        """
        y0, x0, height, width = core
        total = self.net.head_bias.expand(height, width, -1).clone()
        for number, branch in enumerate(self.net.branches):
            s = branch.factor
            shape = self.shapes[branch.last_layer + 1]
            parts = self._head_parts[number].view(shape.height + 2, shape.width + 2, s, s, -1)
            lines, columns = slice(y0 // s + 1, (y0 + height) // s + 1), slice(x0 // s + 1, (x0 + width) // s + 1)
            total += parts[lines, columns].permute(0, 2, 1, 3, 4).reshape(height, width, -1)
        return total

    def tape(self, live: CellSet, needed: list[CellSet], outputs: CellSet) -> CellTape:
        """What a backward pass from the outputs to the canvas cells `live` needs. Later calls do not touch it."""
        reach, activations = live & needed[0], []
        cells = [np.flatnonzero(reach)]
        for index, layer in enumerate(self.net.chain):
            reach = reached(reach, layer.stride) & needed[index + 1]
            cells.append(np.flatnonzero(reach))
            activations.append(self._activations[index + 1].index_select(0, torch.from_numpy(cells[-1])))
        up_cells, up_active = [], []
        for number, branch in enumerate(self.net.branches):
            wanted = pooled(outputs, branch.factor).reshape(-1)
            up_cells.append(cells[branch.last_layer + 1][wanted[cells[branch.last_layer + 1]]])
            up_active.append(self._up_active[number].index_select(0, torch.from_numpy(up_cells[-1])))
        return CellTape(self.net, self.shapes, cells, activations, up_cells, up_active)


def _batches(cells: CellNumbers, dtype: torch.dtype) -> Iterator[CellNumbers]:
    """Cells a batch at a time. In bfloat16 the last one stands in a batch as often as makes it a round one: it is
    computed again to the same values."""
    for start in range(0, len(cells), ROWS_AT_ONCE):
        part = cells[start : start + ROWS_AT_ONCE]
        yield np.pad(part, (0, pad_to_bucket(len(part)) - len(part)), mode="edge") if dtype == torch.bfloat16 else part


def _product(rows: Tensor, weight: Tensor) -> Tensor:
    """rows (N, in) @ weight (in, out), in bfloat16 as part of a round batch."""
    if weight.dtype != torch.bfloat16:
        return rows @ weight
    more = pad_to_bucket(len(rows)) - len(rows)
    return (torch.nn.functional.pad(rows, (0, 0, 0, more)) @ weight)[: len(rows)]


def _split(cells: CellSet, wanted: CellSet) -> tuple[CellSet, CellSet]:
    return cells & wanted, cells & ~wanted


@dataclass(frozen=True)
class CellTape:
    """The backward pass from class logits to the live cells of the canvas.

    cells: of the input and of every layer, ascending, those that depend on a live cell and are needed.
    activations: (n, C) each, of the layers' cells. up_cells: of the branches, where they are upsampled; up_active:
    (n, s² u) each, which outputs are positive there.
    """

    net: CellBackbone
    shapes: list[MapShape]
    cells: list[CellNumbers]
    activations: list[Tensor]
    up_cells: list[CellNumbers]
    up_active: list[Tensor]

    def gradient(self, logits: Tensor) -> Tensor:
        """(L, C) gradient at the live cells, by number, from that at the class logits (rows of the window, anchors).

        Runs through cells between a live cell and a logit with a gradient that is not zero, and through no other.
        """
        chain = self.net.chain
        outputs = empty_set(self.shapes[0])
        outputs.reshape(-1)[np.flatnonzero(logits.numpy()) // self.net.anchors] = True
        wanted = self.net.needed(outputs)
        above, gradient = self.cells[-1][:0], chain[-1].weight.new_zeros(0, len(chain[-1].weight))
        for index in range(len(chain), 0, -1):
            kept = np.flatnonzero(wanted[index].reshape(-1)[self.cells[index]])
            here = self.cells[index][kept]
            if index < len(chain):
                total = self._through(index, gradient, above, here)
            else:
                total = gradient.new_zeros(len(here), gradient.shape[1])
            for number, branch in enumerate(self.net.branches):
                if branch.last_layer == index - 1:
                    self._add_branch(number, logits, outputs, here, total)
            activations = self.activations[index - 1].index_select(0, torch.from_numpy(kept))
            above, gradient = here, torch.ops.aten.threshold_backward(total, activations, 0)
        return self._through(0, gradient, above, self.cells[0])

    def _through(self, index: int, gradient: Tensor, outputs: CellNumbers, inputs: CellNumbers) -> Tensor:
        """The gradient (n, c_in) at a layer's inputs from that (m, c_out) at its outputs, before the ReLU."""
        layer, shape = self.net.chain[index], self.shapes[index]
        channels = layer.weight.shape[1] // 9
        place = np.full(shape.rows, len(inputs), dtype=np.int64)  # one row more, for what nobody asks for
        place[inputs] = np.arange(len(inputs))
        result = gradient.new_zeros(len(inputs) + 1, channels, dtype=self.net.exact)
        for start in range(0, len(outputs), ROWS_AT_ONCE):
            stop = start + ROWS_AT_ONCE
            target = torch.from_numpy(place[shape.neighbours(outputs[start:stop], layer.stride)].reshape(-1))
            shares = _product(gradient[start:stop], layer.weight).view(-1, channels)
            result.index_add_(0, target, shares.to(self.net.exact))
        return result[:-1].to(gradient.dtype)

    def _add_branch(self, number: int, logits: Tensor, outputs: CellSet, cells: CellNumbers, total: Tensor) -> None:
        """Add to total (n, C), at these cells of a block's last layer, what comes back through its upsampling."""
        branch, all_cells = self.net.branches[number], self.up_cells[number]
        kept = np.flatnonzero(pooled(outputs, branch.factor).reshape(-1)[all_cells])
        fine = fine_cells(all_cells[kept], branch.factor, self.shapes[0])
        classes = branch.heads[:, : self.net.anchors].t()
        features = logits.index_select(0, torch.from_numpy(fine.reshape(-1))) @ classes
        active = self.up_active[number].index_select(0, torch.from_numpy(kept))
        features = features.view(active.shape).to(total.dtype) * active
        rows = torch.from_numpy(np.searchsorted(cells, all_cells[kept]))
        total.index_add_(0, rows, _product(features, branch.up_weight))
