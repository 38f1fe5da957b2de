"""Second returns: hits behind a surface that lets part of the beam pass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from shift3d.scenes.street.build.world import World
from shift3d.scenes.street.raycast import Float, Hits, Sweep
from shift3d.scenes.street.returns import Cells, Paint, finish
from shift3d.scenes.street.shapes import Material

SEPARATION_M = 1.0
"""Echoes closer together than this merge in the sensor (our choice: the length in space of a pulse of 7 ns)."""
_SIDES = ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0))  # of a beam's cone: left, right, up, down


def second_returns(
    world: World,
    sweep: Sweep,
    range_m: NDArray[np.float32],
    kept: NDArray[np.bool_],
    paint: dict[int, Paint],
    rng: np.random.Generator,
) -> tuple[Cells, NDArray[np.float32], NDArray[np.float32]]:
    """Compute the second returns of the beams that have a first return.

    Part of the light continues if the first hit is
        foliage: the first leaves cover a random share of the beam's width, the rest continues among the leaves (hedges
            are solid: foliage that dense lets nothing pass a metre deep);
        glass: windows let through the share that they do not reflect, on the way there and on the way back;
        a silhouette: one side of the beam's cone misses the object that its axis hits. (Only another object behind it
            counts: ground at a grazing angle stretches an echo but does not split it.)
    The second echo enters the power law with that share, and lies at least SEPARATION_M behind the first.

    Args:
        sweep: first hits; range_m, kept: (rows, columns) from `finish`.

    Returns: The beams' cells (row and column (K,), row by row), ranges (K,) and reflectances (K,), float32. Source: our
    choice, from the physics.
    """
    through, through_hits, through_share = _through(world, sweep, kept, paint, rng)
    edge, edge_hits, edge_share = _behind_silhouettes(world, sweep, kept, rng)
    cell = np.concatenate((through, edge))
    share = np.concatenate((through_share, edge_share))
    order = np.argsort(cell, kind="stable")
    joined = [np.concatenate(parts)[order] for parts in zip(_parts(through_hits), _parts(edge_hits))]
    second_range_m, reflectance, second_kept = finish(Hits(sweep.sensor, *joined), paint, rng, share[order])
    cell = cell[order]
    second_kept &= second_range_m - range_m.reshape(-1)[cell] >= SEPARATION_M
    row, column = np.unravel_index(cell[second_kept], kept.shape)
    return (row, column), second_range_m[second_kept], reflectance[second_kept]


def _through(
    world: World, sweep: Sweep, kept: NDArray[np.bool_], paint: dict[int, Paint], rng: np.random.Generator
) -> tuple[NDArray[np.intp], Hits, Float]:
    """Return flat cells of beams that pass foliage or glass, their next hits, and the share that passes."""
    glass = sweep.material == Material.GLASS
    items = range(max(int(sweep.item.max()), 0) + 1)
    passing = np.array([paint[number].glass_loss ** 2 if number in paint else 0.0 for number in items])
    share = np.where(glass, passing[np.maximum(sweep.item, 0)], 0.0)
    leaves = _in_leaves(world, sweep)
    share[leaves] = rng.uniform(0.0, 1.0, int(leaves.sum()))
    cell = np.flatnonzero(kept & np.isfinite(sweep.range_m) & (share > 0.0))
    row, column = np.unravel_index(cell, kept.shape)
    directions = sweep.directions[row, column].astype(np.float64)
    from_m = sweep.range_m[row, column].astype(np.float64) + SEPARATION_M
    hits = world.hits_from(sweep.sensor, _starts(sweep, column), directions, from_m, rng)
    return cell, hits, share.reshape(-1)[cell]


def _behind_silhouettes(
    world: World, sweep: Sweep, kept: NDArray[np.bool_], rng: np.random.Generator
) -> tuple[NDArray[np.intp], Hits, Float]:
    """Return flat cells of beams at a silhouette, the nearest hits behind it, and the share of the cone beside it."""
    solid = (sweep.material != Material.GLASS) & ~_in_leaves(world, sweep)
    cell = np.flatnonzero(kept & solid & _at_range_steps(sweep))
    row, column = np.unravel_index(cell, kept.shape)
    axis, starts = sweep.directions[row, column].astype(np.float64), _starts(sweep, column)
    first_m, item = sweep.range_m[row, column], sweep.item[row, column]
    half = sweep.sensor.divergence_rad / 2
    hits = []
    for left, up in _SIDES:
        aim = np.cos(half) * axis + np.sin(half) * _perpendicular(axis, left, up)
        side = world.hits_from(sweep.sensor, starts, aim, np.zeros(len(cell)), rng)
        side.range_m[(side.range_m < first_m + SEPARATION_M) | (side.item == item)] = np.inf
        hits.append(side)
    ranges = np.stack([side.range_m for side in hits])
    nearest, each = ranges.argmin(axis=0), np.arange(len(cell))
    met = np.isfinite(ranges).any(axis=0)
    chosen = [np.stack(parts)[nearest, each][met] for parts in zip(*map(_parts, hits))]
    # Share of the axis and four sides that pass the edge and hit something.
    share = np.isfinite(ranges).sum(axis=0) / (len(_SIDES) + 1)
    return cell[met], Hits(sweep.sensor, *chosen), share[met]


def _parts(hits: Hits) -> tuple[NDArray[Any], ...]:
    return hits.range_m, hits.item, hits.material, hits.cosine


def _at_range_steps(sweep: Sweep) -> NDArray[np.bool_]:
    """Mark hits with another object well behind in a neighbouring cell; no silhouette can cut the other hits.

    A beam's cone is narrower than the steps between beams. (Some gaps narrower than the steps are missed.)
    """
    behind: NDArray[np.bool_] = np.zeros(sweep.range_m.shape, dtype=np.bool_)
    nearer = sweep.range_m + SEPARATION_M
    for axis in (0, 1):
        for step in (1, -1):
            deeper = (np.roll(sweep.range_m, step, axis) > nearer) & (np.roll(sweep.item, step, axis) != sweep.item)
            if axis == 0:  # first and last columns are neighbours; top and bottom rows are not
                deeper[0 if step == 1 else -1] = False
            behind |= deeper
    behind &= np.isfinite(sweep.range_m)
    return behind


def _in_leaves(world: World, sweep: Sweep) -> NDArray[np.bool_]:
    """Mark hits among loose leaves."""
    numbers = [number for number, _ in world.foliage]
    leaves: NDArray[np.bool_] = (sweep.material == Material.FOLIAGE) & np.isin(sweep.item, numbers)
    return leaves


def _perpendicular(axis: Float, left: float, up: float) -> Float:
    """Compute unit vectors (N, 3) at right angles to the beams, to their left or upwards."""
    flat = np.hypot(axis[:, 0], axis[:, 1])
    leftwards = np.stack((-axis[:, 1], axis[:, 0], np.zeros(len(axis))), axis=1) / flat[:, None]
    return left * leftwards + up * np.cross(axis, leftwards)


def _starts(sweep: Sweep, column: NDArray[np.intp]) -> Float:
    """Return the origins (K, 3) of the beams of some columns."""
    only_one = len(sweep.origins_m) == 1
    return sweep.origins_m[np.zeros_like(column) if only_one else column]
