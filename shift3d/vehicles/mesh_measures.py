"""Dimensions of a vehicle measured on its mesh, with the terms and units of a data sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from trimesh.graph import connected_component_labels

if TYPE_CHECKING:
    import trimesh

FloatArray = NDArray[np.float64]
_STEP_M, _STEPS = 0.01, 5
_MIDDLE_M = 0.25
_WINDSHIELD_FROM, _WINDSHIELD_RISE = (0.60, 0.75), 0.20
_NOSE, _CONTACT_M = 0.1, 0.08
_SMALLEST_M3 = 1e-6
DEFINITIONS = {
    "length, width, height": "outer sizes of the mesh in the vehicle's own axes",
    "ground clearance": "lowest surface over the middle third of the length, above the mesh's lowest point",
    "windshield": "steepest climb of the upper outline, followed from the foremost point backwards, over a fifth of "
    "its height that begins between 60 % and 75 % of it: angle to the horizontal of the line between the places where "
    "it first reaches both; the outline is the highest surface within 25 cm of the middle",
    "bonnet": "horizontal way from the foremost point to where the outline begins to climb half as steeply as there",
    "rear window": "as the windshield, from the rearmost point forwards",
    "nose height": "that outline's height a tenth of the length behind the foremost point",
    "tail height": "that outline's height a tenth of the length before the rearmost point",
    "overhangs, wheelbase": "from the foremost and to the rearmost point, and between them: the middles of what lies "
    "within 8 cm of the ground in the front and the rear half; left out where either is over 1 m long, or none",
    "volume": "enclosed by the mesh; left out where the mesh is not closed",
    "pieces": "connected outer surfaces that enclose a cubic centimetre or more, cavities left out; a car has one",
}


@dataclass(frozen=True)
class Measures:
    """Dimensions measured on a mesh, see `DEFINITIONS`. None: the mesh has no such feature."""

    length_cm: float
    width_cm: float
    height_cm: float
    clearance_cm: float | None
    nose_cm: float | None
    tail_cm: float | None
    bonnet_cm: float | None
    windshield_deg: float | None
    rear_window_deg: float | None
    front_overhang_cm: float | None
    wheelbase_cm: float | None
    rear_overhang_cm: float | None
    volume_m3: float | None
    pieces: int


def measure_mesh(mesh: trimesh.Trimesh) -> Measures:
    """Measure a vehicle's mesh.

    Args:
        mesh: object frame (x forward, y left, z up), metres; its lowest point counts as the ground.
    Differentiable w.r.t. nothing. Source: our choice: the definitions also hold for a shape without wheels, which
    ISO 612's ground clearance (tests/unit/vehicles/mesh_dimensions.py) needs.
    """
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    length, width, height = (100.0 * (high - low)).tolist()
    x, top = _outline(mesh, low, high)
    windshield, rear_window = _slope(x, top), _slope(-x[::-1], top[::-1])
    front, base, rear = _axles_cm(mesh, low, high)
    return Measures(
        length_cm=length,
        width_cm=width,
        height_cm=height,
        clearance_cm=_clearance_cm(mesh, low, high),
        nose_cm=_end_cm(x, top),
        tail_cm=_end_cm(-x[::-1], top[::-1]),
        bonnet_cm=None if windshield is None else 100.0 * (float(high[0]) - windshield[1]),
        windshield_deg=None if windshield is None else windshield[0],
        rear_window_deg=None if rear_window is None else rear_window[0],
        front_overhang_cm=front,
        wheelbase_cm=base,
        rear_overhang_cm=rear,
        volume_m3=float(mesh.volume) if mesh.is_watertight else None,
        pieces=_pieces(mesh),
    )


def _pieces(mesh: trimesh.Trimesh) -> int:
    """Count the outer surfaces. The surface of a cavity faces inwards, so its volume is negative."""
    piece = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    a, b, c = np.moveaxis(np.asarray(mesh.triangles) - mesh.bounds.mean(axis=0), 1, 0)
    volume_m3 = np.bincount(piece, weights=(a * np.cross(b, c)).sum(axis=1) / 6.0)
    return max(1, int((volume_m3 > _SMALLEST_M3).sum()))


def _grid(low: float, high: float) -> FloatArray:
    """Return the centres of cells of about 1 cm. No centre lies on a bound, where a ray may miss the mesh."""
    count = max(1, round((high - low) / _STEP_M))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _surface(mesh: trimesh.Trimesh, x: FloatArray, y: FloatArray, start_z: float, upwards: bool) -> FloatArray:
    """Cast vertical rays at every x and y. Returns (X, Y), z of the first hit, NaN for a miss."""
    at_x, at_y = np.meshgrid(x, y, indexing="ij")
    origins = np.stack((at_x.ravel(), at_y.ravel(), np.full(at_x.size, start_z)), axis=1)
    directions = np.broadcast_to((0.0, 0.0, 1.0 if upwards else -1.0), origins.shape)
    points, beams, _ = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    found = np.full(at_x.size, np.nan)
    found[beams] = points[:, 2]
    return found.reshape(at_x.shape)


def _clearance_cm(mesh: trimesh.Trimesh, low: FloatArray, high: FloatArray) -> float | None:
    third = (high[0] - low[0]) / 3.0
    x, y = _grid(low[0] + third, high[0] - third), _grid(low[1], high[1])
    under = _surface(mesh, x, y, low[2] - 1.0, upwards=True)
    return None if np.isnan(under).all() else 100.0 * float(np.nanmin(under) - low[2])


def _outline(mesh: trimesh.Trimesh, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x (X,), descending, and the highest z (X,) near the centre line, above the mesh's lowest point."""
    middle = (low[1] + high[1]) / 2.0
    half = min(_MIDDLE_M, (high[1] - low[1]) / 2.0)
    x, y = _grid(low[0], high[0])[::-1], _grid(middle - half, middle + half)
    found = _surface(mesh, x, y, high[2] + 1.0, upwards=False)
    held = ~np.isnan(found).all(axis=1)
    return x[held], np.nanmax(found[held], axis=1) - low[2] if held.any() else np.empty(0)


def _end_cm(x: FloatArray, top: FloatArray) -> float | None:
    """Return the outline's height in cm at a tenth of its length behind its first point; x descending."""
    if not len(x):
        return None
    behind = np.flatnonzero(x <= x[0] - _NOSE * (x[0] - x[-1]))
    return 100.0 * float(top[behind[0]])


def _slope(x: FloatArray, top: FloatArray) -> tuple[float, float] | None:
    """Return the steepest climb of an outline in degrees and the x where the climb begins; x descending."""
    if not len(top):
        return None
    reached = np.maximum.accumulate(top) / top.max()
    steepest, begins = 0.0, 0
    for share in np.linspace(*_WINDSHIELD_FROM, 16):
        foot, head = (int(np.argmax(reached >= level)) for level in (share, share + _WINDSHIELD_RISE))
        # Both levels are first reached within one centimetre of x: the climb counts as vertical.
        angle = float(np.degrees(np.arctan2(top[head] - top[foot], x[foot] - x[head]))) if head > foot else 90.0
        if angle > steepest:
            steepest, begins = angle, foot
    rise = np.tan(np.radians(min(steepest, 80.0))) / 2 * _STEPS * _STEP_M
    # Follow the climb downwards while the outline rises at least half as steeply.
    while begins >= _STEPS and top[begins] - top[begins - _STEPS] > rise:
        begins -= 1
    return steepest, float(x[begins])


def _axles_cm(
    mesh: trimesh.Trimesh, low: FloatArray, high: FloatArray
) -> tuple[float | None, float | None, float | None]:
    """Return front overhang, wheelbase and rear overhang in cm; all None without two axles."""
    # The triangles are cut: of a coarse mesh, vertices alone would miss a floor, or one side of a tyre.
    cut_at = np.array(((low + high) / 2.0, low + np.array((0.0, 0.0, _CONTACT_M))))
    halves = [mesh.slice_plane(cut_at, [(side, 0.0, 0.0), (0.0, 0.0, -1.0)]).vertices[:, 0] for side in (1.0, -1.0)]
    axles = [(half.min() + half.max()) / 2 for half in halves if len(half) > 0 and np.ptp(half) < 1]
    if len(axles) < 2:
        return None, None, None
    front, rear = axles
    return 100.0 * float(high[0] - front), 100.0 * float(front - rear), 100.0 * float(rear - low[0])
