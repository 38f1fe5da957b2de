"""Search for a mesh's orientation: of the candidates along its long axis, the one that a vehicle decoder fits best."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from shift3d.sdf.autodecode import CLAMP, autodecode_each
from shift3d.sdf.decoder import Decoder
from shift3d.sdf.samples import SdfSamples
from shift3d.vehicles.mesh_frame import AXES, MeshFrame

STEPS, POINTS_A_STEP, SAMPLES = 40, 256, 2_000
BETTER_ERROR_RATIO = 0.9
"""Ratio to the given orientation's error below which another orientation counts as better. For ten correctly oriented
cars unknown to the shipped decoder, no other orientation is below 1.15. The right orientation has at most 0.78 for
these cars upside down, and at most 0.9 for nine cars turned back to front."""


def frames_along(frame: MeshFrame) -> list[MeshFrame]:
    """Return the eight orientations with the nose at either end of `frame`'s forward axis; `frame` comes first."""
    forwards = [frame.forward, *(axis for axis in AXES if axis[1] == frame.forward[1] and axis != frame.forward)]
    ups = [frame.up, *(axis for axis in AXES if axis[1] != frame.forward[1] and axis != frame.up)]
    return [replace(frame, forward=forward, up=up) for forward in forwards for up in ups]


def better_frame(decoder: Decoder, samples: SdfSamples, frame: MeshFrame) -> MeshFrame | None:
    """Return an orientation that a few auto-decoding steps fit clearly better than `frame`, or None.

    Args: samples: of the mesh in the orientation `frame`.
    Source: our choice: eight short searches together cost a third of the full search for the code.
    """
    frames = frames_along(frame)
    points = torch.from_numpy(np.stack([reorient_points(samples.points, frame, other) for other in frames]))
    distances = torch.from_numpy(samples.distances)
    codes = autodecode_each(decoder, points, distances, steps=STEPS, batch=POINTS_A_STEP)
    stride = max(1, len(distances) // SAMPLES)
    errors = _errors(decoder, codes, points[:, ::stride], distances[::stride])
    best = int(errors.argmin())
    return frames[best] if errors[best] < BETTER_ERROR_RATIO * errors[0] else None


def reorient_points(points: NDArray[Any], frame: MeshFrame, other: MeshFrame) -> NDArray[np.float32]:
    """Transform points (N, 3) about the origin from the object frame of `frame` to that of `other`."""
    return np.asarray(points @ (other.object_R_file() @ frame.object_R_file().T).T, np.float32)


def _errors(decoder: Decoder, codes: Tensor, points: Tensor, distances: Tensor) -> Tensor:
    """Return (shapes,) mean absolute errors of the clamped distances."""
    with torch.no_grad():
        predicted = decoder.grouped(codes, points.contiguous(), torch.float32).clamp(-CLAMP, CLAMP)
    return (predicted - distances.clamp(-CLAMP, CLAMP)).abs().mean(dim=1)
