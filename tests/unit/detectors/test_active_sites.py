"""Sets of cells pass through a convolution like its non-zero entries."""

import numpy as np
import pytest
import torch
from torch.nn.functional import conv2d, conv_transpose2d, max_pool2d

from shift3d.detectors.incremental.active_sites import (
    MapShape,
    empty_mask,
    fine_cells,
    full_mask,
    pooled,
    reached,
    sources,
)

KERNEL = torch.ones(1, 1, 3, 3)


def _random_set(shape: MapShape, share: float, seed: int) -> np.ndarray:
    cells = empty_mask(shape)
    cells[1:-1, 1:-1] = np.random.default_rng(seed).random((shape.height, shape.width)) < share
    return cells


def _map(cells: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(cells[1:-1, 1:-1].copy()).float()[None, None]


def _same(cells: np.ndarray, expected: torch.Tensor) -> bool:
    ring_is_empty = not (cells[[0, -1]].any() or cells[:, [0, -1]].any())
    return ring_is_empty and bool(torch.equal(_map(cells) > 0, expected > 0))


@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("shape", [MapShape(12, 20), MapShape(13, 8), MapShape(3, 3)])
def test_sets_follow_a_convolution_of_ones_both_ways(shape: MapShape, stride: int) -> None:
    for seed in range(5):
        cells = _random_set(shape, 0.05, seed)
        forward = conv2d(_map(cells), KERNEL, stride=stride, padding=1)
        assert _same(reached(cells, stride), forward)
        strided = shape.strided(stride)
        assert (strided.height, strided.width) == tuple(forward.shape[2:])
        outputs = _random_set(strided, 0.1, seed + 10)
        rest = [size - ((out - 1) * stride + 1) for size, out in zip((shape.height, shape.width), forward.shape[2:])]
        back = conv_transpose2d(_map(outputs), KERNEL, stride=stride, padding=1, output_padding=rest)
        assert _same(sources(outputs, stride, shape), back)


@pytest.mark.parametrize("stride", [1, 2])
def test_neighbours_are_what_the_kernel_reads(stride: int) -> None:
    shape = MapShape(6, 10)
    values = torch.zeros(shape.height + 2, shape.width + 2)
    values[1:-1, 1:-1] = torch.randn(shape.height, shape.width, generator=torch.Generator().manual_seed(0))
    kernel = torch.arange(9.0).view(1, 1, 3, 3) + 1
    expected = conv2d(values[None, None, 1:-1, 1:-1], kernel, stride=stride, padding=1)[0, 0]
    read = shape.neighbours(np.flatnonzero(full_mask(shape.strided(stride))), stride)
    assert torch.allclose(values.view(-1)[torch.from_numpy(read)] @ kernel.view(9), expected.reshape(-1), atol=1e-5)


@pytest.mark.parametrize("factor", [1, 2, 4])
def test_pooling_and_its_reverse(factor: int) -> None:
    shape = MapShape(8, 12)
    cells = _random_set(shape, 0.04, 3)
    coarse = pooled(cells, factor)
    assert _same(coarse, max_pool2d(_map(cells), factor))
    fine = fine_cells(np.flatnonzero(coarse), factor, shape)
    assert fine.shape[1] == factor**2 and len(np.unique(fine)) == fine.size
    covered = empty_mask(shape)
    covered.reshape(-1)[fine] = True
    assert _same(covered, torch.nn.functional.interpolate(_map(coarse), scale_factor=factor))
