"""Cache of the activations of one window across frames; recomputes cells that changed and are needed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import linear

from shift3d.detectors.incremental.active_sites import CellIndices, CellMask, MapShape, full_mask, pooled, reached
from shift3d.detectors.incremental.sparse_backbone import ROWS_AT_ONCE, SparseBackbone, SparseBackward
from shift3d.processor import pad_to_bucket


class ActivationCache:
    """Activations of one window. canvas: (rows, C) pillar features by cell, backbone dtype; callers write it."""

    def __init__(self, net: SparseBackbone, window: MapShape) -> None:
        self.net = net
        self.shapes = net.shapes(window)
        widths = [net.chain[0].weight.shape[1] // 9, *(layer.weight.shape[0] for layer in net.chain)]
        # Zeros that are never written take no memory: the system allocates a page at its first write.
        self._activations = [
            net.chain[0].weight.new_zeros(shape.rows, width) for shape, width in zip(self.shapes, widths, strict=True)
        ]
        self._up_active = []
        self._head_parts = []
        for branch in net.branches:
            rows, (channels, outputs) = self.shapes[branch.last_layer + 1].rows, branch.heads.shape
            self._up_active.append(torch.zeros(rows, branch.factor**2 * channels, dtype=torch.bool))
            self._head_parts.append(branch.heads.new_zeros(rows, branch.factor**2 * outputs))
        # Cells that changed since they were last computed; initially all cells.
        self._stale = [full_mask(shape) for shape in self.shapes]
        self._stale_heads = [full_mask(self.shapes[branch.last_layer + 1]) for branch in net.branches]

    @property
    def canvas(self) -> Tensor:
        return self._activations[0]

    def due(self, changed: CellMask, needed: CellMask) -> CellMask:
        """Return the input cells that the caller must write before `advance`: changed and needed cells.

        Changed cells that are not needed stay marked as stale until a later call needs them.
        """
        due, self._stale[0] = _split(changed | self._stale[0], needed)
        return due

    def advance(self, written: CellMask, needed: list[CellMask], outputs: CellMask) -> None:
        """Recompute the needed cells of all layers that depend on the written canvas cells.

        needed: `SparseBackbone.needed` of the output cells `outputs`. Not differentiable: see `SparseBackward`.
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

    def _convolve(self, index: int, cells: CellIndices) -> None:
        layer, source, target = self.net.chain[index], self._activations[index], self._activations[index + 1]
        for part in _batches(cells, layer.weight.dtype):
            neighbours = torch.from_numpy(self.shapes[index].neighbours(part, layer.stride).reshape(-1))
            gathered = source.index_select(0, neighbours).view(len(part), -1)
            target.index_copy_(0, torch.from_numpy(part), linear(gathered, layer.weight, layer.bias).relu_())

    def _upsample(self, number: int, cells: CellIndices) -> None:
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
        """Return the head outputs (h, w, H) of the core (y0, x0, height, width), aligned to the stride; exact dtype.

        H: class logits of the cell's proposals, then the outputs of the box layers.
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

    def backward(self, with_grad: CellMask, needed: list[CellMask], outputs: CellMask) -> SparseBackward:
        """Return the backward pass from the outputs to the canvas cells `with_grad`; later calls do not change it."""
        reach, activations = with_grad & needed[0], []
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
        return SparseBackward(self.net, self.shapes, cells, activations, up_cells, up_active)


def _batches(cells: CellIndices, dtype: torch.dtype) -> Iterator[CellIndices]:
    """Split cells into batches. In bfloat16 the last cell repeats up to `pad_to_bucket` rows, with the same result."""
    for start in range(0, len(cells), ROWS_AT_ONCE):
        part = cells[start : start + ROWS_AT_ONCE]
        yield np.pad(part, (0, pad_to_bucket(len(part)) - len(part)), mode="edge") if dtype == torch.bfloat16 else part


def _split(cells: CellMask, wanted: CellMask) -> tuple[CellMask, CellMask]:
    return cells & wanted, cells & ~wanted
