"""How two meshes differ, in words and in the lines of a table."""

from __future__ import annotations

from shift3d.analysis.tables.patterns import NAMES
from shift3d.vehicles.mesh_measures import Measures

# Sentences for less and more, and from which change on a change is named: below it the mesh's own grid speaks.
_WORDS = {
    "length_cm": ("{} cm shorter", "{} cm longer", 1.0),
    "height_cm": ("{} cm lower", "{} cm higher", 1.0),
    "width_cm": ("{} cm narrower", "{} cm wider", 1.0),
    "clearance_cm": ("underside {} cm nearer to the ground", "underside {} cm farther from the ground", 1.0),
    "nose_cm": ("nose {} cm lower", "nose {} cm higher", 1.0),
    "tail_cm": ("tail {} cm lower", "tail {} cm higher", 1.0),
    "bonnet_cm": ("bonnet {} cm shorter", "bonnet {} cm longer", 1.0),
    "windshield_deg": ("windshield {}° flatter", "windshield {}° steeper", 1.0),
}


def change_lines(before: Measures, after: Measures) -> list[list[str]]:
    """Lines of a table: measure, baseline, adversarial, change."""
    lines = []
    for field, (name, unit, digits) in NAMES.items():
        old, new = getattr(before, field), getattr(after, field)
        change = "-" if old is None or new is None else f"{_signed(new - old, digits)} {unit}".strip()
        lines.append([name, *(_with_unit(value, unit, digits) for value in (old, new)), change])
    return lines


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text if float(text) else f"{0:.{digits}f}"


def _with_unit(value: float | None, unit: str, digits: int) -> str:
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
