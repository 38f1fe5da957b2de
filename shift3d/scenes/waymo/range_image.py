"""Conversion of range images to beams, by the geometry of the data set's published tools for version 2.

Frames: ``laser`` (the sensor's own), ``vehicle`` (x forward, y left, z up, at the frame's time), ``global``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.geometry.rigid import inverse, rigid, rotation_of_angles

Float = NDArray[np.float64]


@dataclass(frozen=True)
class LaserCalibration:
    """Calibration of one laser of the vehicle.

    vehicle_SE3_laser: (4, 4). inclination_rad: lowest and highest beam. beams_rad: inclination of each beam from the
    lowest up; None: evenly spaced between the two.
    """

    vehicle_SE3_laser: Float  # noqa: N815
    inclination_rad: tuple[float, float]
    beams_rad: Float | None


def inclinations(laser: LaserCalibration, height: int, where: str) -> Float:
    """Compute the inclinations (height,) of the image's rows, radians, the highest beam first.

    Raises InputError: a table of another length, or angles that are not radians.
    """
    if laser.beams_rad is None:
        low, high = laser.inclination_rad
        beams = low + (np.arange(height) + 0.5) / height * (high - low)
    else:
        beams = laser.beams_rad
    if len(beams) != height:
        what = f"{len(beams)} beam inclinations for a range image of {height} rows"
        raise InputError(what, where, "Pair components of one segment")
    if not (np.abs(beams) < np.pi / 2).all():
        raise InputError("a beam inclination that is no angle in radians", where, "Copy the calibration again")
    return beams[::-1].astype(np.float64)


def filled_poses(poses: NDArray[np.floating], where: str) -> Float:
    """Fill all-zero poses (H, W, 6) of pixels from the nearest row above that has a pose.

    The bottom rows of published images may be zero. The pixels of a column fire together, so that poses differ little
    along it. A column without any pose takes those of the nearest column.

    Raises InputError: no pixel has a pose, or one has NaN. Source: our choice.
    """
    array: Float = np.asarray(poses, np.float64)
    if not np.isfinite(array).all():
        raise InputError("a pixel's pose is not finite", where, "Copy the component again")
    known = (array != 0.0).any(axis=-1)
    if known.all():
        return array
    if not known.any():
        raise InputError("every pixel's pose is zero", where, "Copy the component again")
    height, width = known.shape
    row = np.maximum.accumulate(np.where(known, np.arange(height)[:, None], -1), axis=0)
    row = np.where(row < 0, known.argmax(axis=0), row)
    columns = np.flatnonzero(known.any(axis=0))
    nearest = columns[np.abs(np.arange(width)[:, None] - columns).argmin(axis=1)]
    filled: Float = array[row[:, nearest], nearest]
    return filled


def vehicle_SE3_pixels(poses: Float, global_SE3_vehicle: Float) -> Float:
    """Compute transforms (H, W, 4, 4) from the vehicle at each pixel's firing time to the vehicle at the frame's time.

    Args:
        poses: (H, W, 6) roll, pitch, yaw, x, y, z of the vehicle in the global frame.
    """
    pixels = rigid(rotation_of_angles(poses[..., 0], poses[..., 1], poses[..., 2]), poses[..., 3:])
    return inverse(global_SE3_vehicle) @ pixels


def vehicle_beams(
    laser: LaserCalibration, shape: tuple[int, int], pixels: Float | None, where: str
) -> tuple[Float, Float]:
    """Compute origin and direction of each pixel's beam, vehicle frame.

    A return at range r lies at origin + r direction. Column j of W has the azimuth (2 (W - j - 0.5) / W - 1) pi -
    atan2(E10, E00), E the laser's extrinsic; azimuths therefore decrease along a row.

    Args:
        shape: (H, W) of the range image. pixels: (H, W, 4, 4) of `vehicle_SE3_pixels`; None: vehicle at rest.

    Returns:
        origins (H, W, 3), metres, and unit directions (H, W, 3), float64; origins are a broadcast view without pixels.
    """
    height, width = shape
    extrinsic = laser.vehicle_SE3_laser
    up = inclinations(laser, height, where)[:, None]
    turn = (2.0 * (width - np.arange(width) - 0.5) / width - 1.0) * np.pi
    azimuth = (turn - np.arctan2(extrinsic[1, 0], extrinsic[0, 0]))[None]
    own = np.stack(np.broadcast_arrays(np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up)), axis=-1)
    directions = own @ extrinsic[:3, :3].T
    if pixels is None:
        return np.broadcast_to(extrinsic[:3, 3], directions.shape), directions
    origins = pixels[..., :3, :3] @ extrinsic[:3, 3] + pixels[..., :3, 3]
    return origins, np.einsum("hwij,hwj->hwi", pixels[..., :3, :3], directions)
