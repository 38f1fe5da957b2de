"""Conversion of reflectance in files to the scale 0 to 1."""

from __future__ import annotations

from typing import TYPE_CHECKING

from shift3d.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MOST_RAW = 1e5
"""Largest value of full reflectance in any sensor's files."""
STRAY_SHARE = 0.05
"""Share of values that may lie beyond a scale (our choice): flipped bits, mirrors that outshine the sensor's
calibration. A larger share means another scale."""


def full_reflectance(
    values: NDArray[np.floating], where: str, stated: float | None = None, remedy: str = "State its maximum"
) -> float:
    """Find the value of full reflectance. The caller divides by it and clips to 0 to 1.

    stated: the value from the sensor's manual: 1, 255, or for raw intensities up to `MOST_RAW`.
    None: the value is recognised: 1 if values lie in 0 to 1, 255 if they are whole numbers from 0 to 255. If all are
    whole, one value beyond 1 is enough, as in a dark frame. Raw intensities cannot be recognised: the largest value
    differs from scene to scene and is never used.

    Args:
        values: (N,) of one file, finite. where: the file, for errors. remedy: advice if no scale fits.

    Raises InputError, naming file and row: a maximum out of range; more than `STRAY_SHARE` of the values off the scale.
    Source: our choice; mixed scales turned whole frames into fog in a public simulator.
    """
    if stated is not None:
        if not 0.0 < stated <= MOST_RAW:
            raise InputError(f"a largest reflectance of {stated}", where, f"Give more than 0, at most {MOST_RAW:g}")
        _refuse(_off_scale(values, stated), values, where, f"the scale 0 to {stated:g}", remedy)
        return stated
    whole_alone = (values % 1.0 == 0.0).all() and (values > 1.0).any()
    off_unit = values > 1.0 if whole_alone else _off_scale(values, 1.0)
    off_bytes = _off_scale(values, 255.0, whole=True)
    if off_unit.any() and off_bytes.any():
        both = off_unit & off_bytes
        scales = "either of the scales 0 to 1 and 0 to 255 (whole numbers)"
        _refuse(both if both.any() else off_unit, values, where, scales, remedy)
    return 255.0 if off_unit.any() else 1.0


def _off_scale(values: NDArray[np.floating], full: float, whole: bool = False) -> NDArray[np.bool_]:
    """Return the mask (N,) of values off a scale; empty if they are few. whole: only whole numbers may exceed 1."""
    # If hardly any value exceeds 1, fractions show the scale 0 to 1, even if another scale is stated.
    few = STRAY_SHARE * len(values)
    misfits: NDArray[np.bool_] = (values < 0.0) | (values > full)
    if full > 1.0 and (whole or (values > 1.0).sum() <= few):
        misfits |= values % 1.0 != 0.0
    return misfits if misfits.sum() > few else misfits & False


def _refuse(misfits: NDArray[np.bool_], values: NDArray[np.floating], where: str, scale: str, remedy: str) -> None:
    if misfits.any():
        row = int(misfits.argmax())
        count = f"{int(misfits.sum())} of {len(values)} rows are not"
        raise InputError(f"row {row} has reflectance {values[row]:g}, not on {scale} ({count})", where, remedy)
