"""Shaded pictures of meshes by ray casting; needs no display and no graphics driver."""

from __future__ import annotations

import io

import numpy as np
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
LIGHT = np.array([0.45, 0.55, 0.75])
AZIMUTHS_RAD = (np.pi / 2 - 1e-3, 0.6)
MESH_RGB = (0.62, 0.62, 0.60)
BODY_RGB = (0.42, 0.58, 0.80)


def view_axes(azimuth_rad: float, elevation_rad: float) -> Array:
    """Return the camera's axes as rows (right, up, towards the camera); azimuth counts from +x (the nose)."""
    ca, sa, ce, se = np.cos(azimuth_rad), np.sin(azimuth_rad), np.cos(elevation_rad), np.sin(elevation_rad)
    towards = np.array([ca * ce, sa * ce, se])
    right = np.array([-sa, ca, 0.0])
    return np.stack([right, np.cross(towards, right), towards])


def shaded(
    mesh: trimesh.Trimesh,
    azimuth_rad: float = 0.7,
    elevation_rad: float = 0.3,
    width_px: int = 320,
    height_px: int = 200,
    span_m: float = 5.6,
    rgb: tuple[float, float, float] = BODY_RGB,
) -> NDArray[np.uint8]:
    """Draw an orthographic, Lambert-shaded picture of a mesh around its origin.

    Args:
        mesh: object frame, metres (or any unit, then also the unit of `span_m`).
        azimuth_rad: camera azimuth, counter-clockwise from the nose (pi/2 is the vehicle's left side).
        elevation_rad: camera elevation above the horizon.
        span_m: width of the picture in metres; the height follows from the pixels.
    Returns: (height_px, width_px, 3) uint8, white background.
    Differentiable w.r.t.: nothing. Source: our choice: pictures only.
    """
    axes = view_axes(azimuth_rad, elevation_rad)
    across = (np.arange(2 * width_px) + 0.5) / (2 * width_px) - 0.5
    down = 0.5 - (np.arange(2 * height_px) + 0.5) / (2 * height_px)
    u, v = np.meshgrid(across * span_m, down * span_m * height_px / width_px)
    origins = u.reshape(-1, 1) * axes[0] + v.reshape(-1, 1) * axes[1] + 10.0 * span_m * axes[2]
    directions = np.broadcast_to(-axes[2], origins.shape)
    points, rays, triangles = mesh.ray.intersects_location(origins, directions, multiple_hits=False)
    picture = np.ones((origins.shape[0], 3))
    if len(rays):
        weights = trimesh.triangles.points_to_barycentric(mesh.triangles[triangles], points)
        normals = (mesh.vertex_normals[mesh.faces[triangles]] * weights[..., None]).sum(axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        lamp = LIGHT / np.linalg.norm(LIGHT)
        bright = 0.30 + 0.55 * np.clip(normals @ lamp, 0, 1) + 0.25 * np.clip(normals @ axes[2], 0, 1)
        picture[rays] = np.clip(np.asarray(rgb) * bright[:, None] * 1.15, 0, 1)
    fine = picture.reshape(height_px, 2, width_px, 2, 3).mean(axis=(1, 3))
    return np.asarray(np.round(fine * 255), np.uint8)


def side_by_side(mesh: trimesh.Trimesh, decoded: trimesh.Trimesh) -> bytes:
    """Draw a PNG, 960 pixels wide: side view and front left view of a mesh (grey), then of a decoded mesh (blue).

    Args: both meshes in the object frame, metres, about the origin.
    """
    from matplotlib.image import imsave

    span_m = 1.15 * max(float(np.ptp(mesh.vertices[:, 0])), float(np.ptp(decoded.vertices[:, 0])))
    views = [
        shaded(surface, azimuth, 0.22, 240, 132, span_m, rgb)
        for surface, rgb in ((mesh, MESH_RGB), (decoded, BODY_RGB))
        for azimuth in AZIMUTHS_RAD
    ]
    picture = io.BytesIO()
    imsave(picture, np.concatenate(views, axis=1), format="png")
    return picture.getvalue()
