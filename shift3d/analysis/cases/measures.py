"""A vehicle's measures on its mesh, in the words and units of a data sheet, and how two meshes differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import trimesh

__all__ = ["DEFINITIONS", "Measures", "change_lines", "in_words", "measure_mesh"]

FloatArray = NDArray[np.float64]
_STEP_M = 0.01
_MIDDLE_M = 0.25
_WINDSHIELD_FROM, _WINDSHIELD_RISE = (0.60, 0.75), 0.20
_NOSE = 0.1
DEFINITIONS = {
    "length, width, height": "outer sizes of the mesh in the vehicle's own axes",
    "ground clearance": "lowest surface over the middle third of the length, above the mesh's lowest point",
    "windshield": "steepest climb of the upper outline, followed from the foremost point backwards, over a fifth of "
    "its height that begins between 60 % and 75 % of it: angle to the horizontal of the line between the places where "
    "it first reaches both; the outline is the highest surface within 25 cm of the middle",
    "nose height": "that outline's height a tenth of the length behind the foremost point",
    "volume": "enclosed by the mesh; left out where the mesh is not closed",
    "pieces": "connected surfaces of the mesh; a car has one",
}


@dataclass(frozen=True)
class Measures:
    """What is measured on a mesh, see `DEFINITIONS`. None: the mesh does not have it."""

    length_cm: float
    width_cm: float
    height_cm: float
    clearance_cm: float | None
    nose_cm: float | None
    windshield_deg: float | None
    volume_m3: float | None
    pieces: int


def measure_mesh(mesh: trimesh.Trimesh) -> Measures:
    """Measure a vehicle's mesh.

    Args:
        mesh: object frame (x forward, y left, z up), metres, its lowest point on the ground.

    Differentiable w.r.t. nothing. Source: our choice: definitions that also hold for a shape without wheels, which
    ISO 612's ground clearance (`vehicles.dimensions`) needs.
    """
    low, high = np.asarray(mesh.bounds, dtype=np.float64)
    length, width, height = (100.0 * (high - low)).tolist()
    x, top = _outline(mesh, low, high)
    return Measures(
        length_cm=length,
        width_cm=width,
        height_cm=height,
        clearance_cm=_clearance_cm(mesh, low, high),
        nose_cm=_nose_cm(x, top, low, high),
        windshield_deg=_windshield_deg(x, top),
        volume_m3=float(mesh.volume) if mesh.is_watertight else None,
        pieces=int(mesh.body_count),
    )


def _grid(low: float, high: float) -> FloatArray:
    """Middles of cells of about a centimetre between two bounds: none lies on a bound, where a beam may slip by."""
    count = max(1, round((high - low) / _STEP_M))
    return low + (high - low) * (np.arange(count) + 0.5) / count


def _surface(mesh: trimesh.Trimesh, x: FloatArray, y: FloatArray, start_z: float, upwards: bool) -> FloatArray:
    """z of the first surface along vertical beams at every x and y (X, Y), NaN where there is none."""
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
    """x (X,) from the foremost backwards, and the highest surface near the middle there (X,), above the ground."""
    middle = (low[1] + high[1]) / 2.0
    half = min(_MIDDLE_M, (high[1] - low[1]) / 2.0)
    x, y = _grid(low[0], high[0])[::-1], _grid(middle - half, middle + half)
    found = _surface(mesh, x, y, high[2] + 1.0, upwards=False)
    held = ~np.isnan(found).all(axis=1)
    return x[held], np.nanmax(found[held], axis=1) - low[2] if held.any() else np.empty(0)


def _nose_cm(x: FloatArray, top: FloatArray, low: FloatArray, high: FloatArray) -> float | None:
    behind = np.flatnonzero(x <= high[0] - _NOSE * (high[0] - low[0]))
    return 100.0 * float(top[behind[0]]) if len(behind) else None


def _windshield_deg(x: FloatArray, top: FloatArray) -> float | None:
    if not len(top):
        return None
    reached = np.maximum.accumulate(top) / top.max()
    steepest = 0.0
    for share in np.linspace(*_WINDSHIELD_FROM, 16):
        foot, head = (int(np.argmax(reached >= level)) for level in (share, share + _WINDSHIELD_RISE))
        # Reached within one centimetre of x: as steep as can be told.
        steepest = (
            max(steepest, np.degrees(np.arctan2(top[head] - top[foot], x[foot] - x[head]))) if head > foot else 90.0
        )
    return float(steepest)


_NAMES = {
    "length_cm": ("length", "cm", 0),
    "width_cm": ("width", "cm", 0),
    "height_cm": ("height", "cm", 0),
    "clearance_cm": ("ground clearance", "cm", 1),
    "nose_cm": ("nose height", "cm", 0),
    "windshield_deg": ("windshield", "°", 0),
    "volume_m3": ("volume", "m³", 2),
    "pieces": ("pieces", "", 0),
}
# Sentences for less and more, and from which change on a change is named: below it the mesh's own grid speaks.
_WORDS = {
    "length_cm": ("{} cm shorter", "{} cm longer", 1.0),
    "height_cm": ("{} cm lower", "{} cm higher", 1.0),
    "width_cm": ("{} cm narrower", "{} cm wider", 1.0),
    "clearance_cm": ("underside {} cm nearer to the ground", "underside {} cm farther from the ground", 1.0),
    "nose_cm": ("nose {} cm lower", "nose {} cm higher", 1.0),
    "windshield_deg": ("windshield {}° flatter", "windshield {}° steeper", 1.0),
}


def change_lines(before: Measures, after: Measures) -> list[list[str]]:
    """Lines of a table: measure, baseline, adversarial, change."""
    lines = []
    for field, (name, unit, digits) in _NAMES.items():
        old, new = getattr(before, field), getattr(after, field)
        change = "-" if old is None or new is None else f"{_signed(new - old, digits)} {unit}".strip()
        lines.append([name, *(_said(value, unit, digits) for value in (old, new)), change])
    return lines


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text if float(text) else f"{0:.{digits}f}"


def _said(value: float | None, unit: str, digits: int) -> str:
    return "not measured" if value is None else f"{value:.{digits}f} {unit}".strip()


def in_words(before: Measures, after: Measures) -> str:
    """What changed, in a sentence."""
    parts = []
    for field, (less, more, least) in _WORDS.items():
        old, new = getattr(before, field), getattr(after, field)
        if old is None or new is None or abs(new - old) < least:
            continue
        parts.append((more if new > old else less).format(f"{abs(new - old):.0f}"))
    if before.volume_m3 and after.volume_m3:
        share = after.volume_m3 / before.volume_m3 - 1.0
        if abs(share) >= 0.01:
            parts.append(f"{abs(share):.0%} {'more' if share > 0 else 'less'} volume")
    if after.pieces != before.pieces:
        parts.append(f"{after.pieces} pieces in place of {before.pieces}")
    return f"{', '.join(parts)}." if parts else "No measure changes by 1 cm, 1° or 1 % of the volume."
