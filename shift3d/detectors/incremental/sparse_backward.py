"""The backward pass from class logits to chosen cells of the canvas, through nothing but cells between the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from shift3d.detectors.incremental.active_sites import ActiveSites, MapShape, SiteIndices, empty_set, fine_cells, pooled
from shift3d.detectors.incremental.sparse_backbone import ROWS_AT_ONCE, SparseBackbone
from shift3d.processor import pad_to_bucket


@dataclass(frozen=True)
class SparseBackward:
    """The backward pass from class logits to the cells with a gradient of the canvas.

    cells: of the input and of every layer, ascending, those that depend on a cell with a gradient and are needed.
    activations: (n, C) each, of the layers' cells. up_cells: of the branches, where they are upsampled; up_active:
    (n, s² u) each, which outputs are positive there.
    """

    net: SparseBackbone
    shapes: list[MapShape]
    cells: list[SiteIndices]
    activations: list[Tensor]
    up_cells: list[SiteIndices]
    up_active: list[Tensor]

    def gradient(self, logits: Tensor) -> Tensor:
        """(L, C) gradient at the canvas cells, by number, from that at the class logits (window's cells, per cell).

        Runs through cells between such a cell and a logit with a gradient that is not zero, and through no other.
        """
        chain = self.net.chain
        outputs = empty_set(self.net.output_shape(self.shapes[0]))
        outputs.reshape(-1)[np.flatnonzero(logits.numpy()) // self.net.per_cell] = True
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

    def _through(self, index: int, gradient: Tensor, outputs: SiteIndices, inputs: SiteIndices) -> Tensor:
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

    def _add_branch(self, number: int, logits: Tensor, outputs: ActiveSites, cells: SiteIndices, total: Tensor) -> None:
        """Add to total (n, C), at these cells of a block's last layer, what comes back through its upsampling."""
        branch, all_cells = self.net.branches[number], self.up_cells[number]
        kept = np.flatnonzero(pooled(outputs, branch.factor).reshape(-1)[all_cells])
        fine = fine_cells(all_cells[kept], branch.factor, self.net.output_shape(self.shapes[0]))
        classes = branch.heads[:, : self.net.per_cell].t()
        features = logits.index_select(0, torch.from_numpy(fine.reshape(-1))) @ classes
        active = self.up_active[number].index_select(0, torch.from_numpy(kept))
        features = features.view(active.shape).to(total.dtype) * active
        rows = torch.from_numpy(np.searchsorted(cells, all_cells[kept]))
        total.index_add_(0, rows, _product(features, branch.up_weight))


def _product(rows: Tensor, weight: Tensor) -> Tensor:
    """rows (N, in) @ weight (in, out), in bfloat16 as part of a round batch."""
    if weight.dtype != torch.bfloat16:
        return rows @ weight
    more = pad_to_bucket(len(rows)) - len(rows)
    return (torch.nn.functional.pad(rows, (0, 0, 0, more)) @ weight)[: len(rows)]
