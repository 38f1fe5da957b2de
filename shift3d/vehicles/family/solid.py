"""Vehicle as an implicit solid: side profile x cross-section x plan view, joined by smooth CSG and meshed once.

Working frame: x forward, y left, z up, x = 0 at half the length, z = 0 on the ground, metres. Only the half y >= 0 is
evaluated and then mirrored, so a vehicle is exactly symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from shift3d.vehicles.family import profiles
from shift3d.vehicles.family.spec import VehicleSpec

Array = NDArray[np.float32]
Corner = NDArray[np.float64]
# Not zero: a grid point exactly on the surface would give triangles without area.
LEVELS_M = (1.37e-5, 2.9e-4, -3.1e-4, 6.7e-4, -7.1e-4, 1.9e-3)


@dataclass(frozen=True)
class Grid:
    """Grid axes x (A,), y (B,), z (C,), all float32 metres, with equal spacing; on a half grid y starts at 0."""

    x: Array
    y: Array
    z: Array
    step_m: float


def smooth_max(a: Array, b: Array, radius_m: float) -> Array:
    """Intersect two fields, with the edge rounded over about `radius_m` metres."""
    gap = np.maximum(radius_m - np.abs(a - b), np.float32(0.0))
    return np.asarray(np.maximum(a, b) + gap * gap * np.float32(0.25 / radius_m), np.float32)


def smooth_min(a: Array, b: Array, radius_m: float) -> Array:
    """Unite two fields, with the crease filled over about `radius_m` metres."""
    return -smooth_max(-a, -b, radius_m)


def half_grid(low: Corner, high: Corner, resolution_m: float) -> Grid:
    """Return the half grid of a solid between two corners (x, y, z): three cells of margin, a plane at y = 0."""
    margin = 3.0 * resolution_m

    def axis(first: float, last: float) -> Array:
        cells = int(np.ceil((last - first) / resolution_m))
        return np.asarray(first + resolution_m * np.arange(cells + 1), np.float32)

    reach = float(max(-low[1], high[1])) + margin
    return Grid(
        axis(low[0] - margin, high[0] + margin), axis(0.0, reach), axis(low[2] - margin, high[2] + margin), resolution_m
    )


def polygon_field(grid: Grid, spec: VehicleSpec, polygon: list[tuple[float, float]], blur_m: float) -> Array:
    """Compute the signed distance (A, C) to a side-view polygon of (s, z) corners, rounded by a blur of `blur_m`."""
    s = spec.length_m / 2 - grid.x
    points = np.stack(np.meshgrid(s, grid.z, indexing="ij"), axis=-1).reshape(-1, 2)
    field = profiles.polygon_distance(points, np.asarray(polygon, np.float32)).reshape(len(grid.x), len(grid.z))
    return np.asarray(gaussian_filter(field, blur_m / grid.step_m, mode="nearest"), np.float32)


def spread_with_plan_curvature(grid: Grid, spec: VehicleSpec, field: Array) -> Array:
    """Spread a side-view field (A, C) over y to (A, B, C), shorter towards the sides: noses and glass are curved."""
    half = spec.length_m / 2
    t = np.minimum(grid.y / (spec.width_m / 2), 1.1) ** 2
    stretch = np.where(
        grid.x[:, None] > 0, 1.0 / (1.0 - spec.front_bow_m / half * t), 1.0 / (1.0 - spec.rear_bow_m / half * t)
    )
    position = (grid.x[:, None] * stretch - grid.x[0]) / grid.step_m
    lower = np.clip(np.floor(position).astype(np.int64), 0, len(grid.x) - 2)
    share = np.clip(position - lower, 0.0, 1.0).astype(np.float32)[..., None]
    return np.asarray(field[lower] * (1 - share) + field[lower + 1] * share, np.float32)


def sides(grid: Grid, spec: VehicleSpec, half_width: Array) -> Array:
    """Return the distance to the flanks (A, B, C): |y| minus a half width by height (C,), narrower towards the ends."""
    start = 0.25 * spec.length_m
    reach = np.clip((np.abs(grid.x) - start) / (spec.length_m / 2 - start), 0.0, 1.2)
    taper = (spec.plan_taper_m * reach**2).astype(np.float32)
    return np.asarray(grid.y[None, :, None] - half_width[None, None, :] + taper[:, None, None], np.float32)


def cylinder(
    grid: Grid, centre_x: float, centre_z: float, radius_m: float, y_from: float, y_to: float, round_m: float
) -> Array:
    """Build a wheel-like cylinder along y (A, B, C) with rounded rims."""
    disc = np.hypot(grid.x[:, None] - centre_x, grid.z[None, :] - centre_z).astype(np.float32) - np.float32(radius_m)
    return prism(grid, disc, y_from, y_to, round_m)


def prism(grid: Grid, side_field: Array, y_from: float, y_to: float, round_m: float) -> Array:
    """Extrude a side-view field from y_from to y_to (A, B, C) with rounded rims."""
    slab = np.maximum(np.float32(y_from) - grid.y, grid.y - np.float32(y_to))[None, :, None]
    return smooth_max(side_field[:, None, :], slab, round_m)


def body_field(grid: Grid, spec: VehicleSpec) -> Array:
    """Build the body without wheels (A, B, C): lower body and glasshouse, or an open cabin or bed."""
    lower = smooth_max(
        spread_with_plan_curvature(grid, spec, polygon_field(grid, spec, profiles.lower_body(spec), 0.03)),
        sides(grid, spec, profiles.lower_half_width(spec, grid.z)),
        spec.edge_radius_m,
    )
    flanks = sides(grid, spec, profiles.glasshouse_half_width(spec, grid.z))
    if spec.body_type == "convertible":
        return _open_cabin(grid, spec, lower, flanks)
    cabin = smooth_max(
        spread_with_plan_curvature(grid, spec, polygon_field(grid, spec, profiles.glasshouse(spec), 0.03)),
        flanks,
        1.2 * spec.edge_radius_m,
    )
    body = smooth_min(lower, cabin, 0.05)
    if spec.body_type == "pickup":
        body = _open_bed(grid, spec, body)
    if spec.spoiler_m > 0.03:
        wing = polygon_field(grid, spec, profiles.spoiler(spec), 0.015)
        body = smooth_min(body, prism(grid, wing, -1.0, 0.86 * spec.width_m / 2, 0.05), 0.04)
    return body


def _open_cabin(grid: Grid, spec: VehicleSpec, lower: Array, flanks: Array) -> Array:
    inner = spec.width_m / 2 - 0.15
    hollow = polygon_field(grid, spec, profiles.cabin_cavity(spec), 0.03)
    cavity = prism(grid, hollow, -1.0, inner, 0.10)
    body = smooth_max(lower, -cavity, 0.05)
    screen = spread_with_plan_curvature(grid, spec, polygon_field(grid, spec, profiles.windshield_frame(spec), 0.015))
    body = smooth_min(body, smooth_max(screen, flanks, 0.06), 0.04)
    for polygon, y_from, y_to in profiles.seats(spec):
        body = smooth_min(body, prism(grid, polygon_field(grid, spec, polygon, 0.02), y_from, y_to, 0.08), 0.03)
    return body


def _open_bed(grid: Grid, spec: VehicleSpec, body: Array) -> Array:
    bed = spread_with_plan_curvature(grid, spec, polygon_field(grid, spec, profiles.bed(spec), 0.02))
    walls = sides(grid, spec, profiles.lower_half_width(spec, grid.z) - np.float32(0.11))
    return smooth_max(body, -smooth_max(bed, walls, 0.12), 0.04)


def car_field(grid: Grid, spec: VehicleSpec) -> Array:
    """Build the whole vehicle on a half grid that contains it: (A, B, C) float32, negative inside, about metres."""
    field = body_field(grid, spec)
    outer = spec.width_m / 2
    arch = spec.wheel_radius_m + spec.arch_gap_m
    inner = outer - 0.04 - spec.tyre_width_m
    for axle_s in (spec.front_axle_s_m, spec.front_axle_s_m + spec.wheelbase_m):
        axle_x = spec.length_m / 2 - axle_s
        # Without fenders the arches would break through a low hood, an open cabin or a load bed.
        fender = cylinder(grid, axle_x, spec.wheel_radius_m, arch + 0.06, inner - 0.10, outer - 0.03, 0.06)
        fender = np.maximum(fender, np.float32(spec.clearance_m + 0.03) - grid.z)
        field = smooth_min(field, fender, 0.05)
        field = smooth_max(
            field, -cylinder(grid, axle_x, spec.wheel_radius_m, arch, inner - 0.02, outer + 1.0, 0.03), 0.03
        )
        wheel = cylinder(grid, axle_x, spec.wheel_radius_m, spec.wheel_radius_m, inner - 0.08, outer - 0.035, 0.05)
        dish = cylinder(grid, axle_x, spec.wheel_radius_m, 0.62 * spec.wheel_radius_m, outer - 0.065, outer + 1.0, 0.03)
        field = np.minimum(field, smooth_max(wheel, -dish, 0.02))
    return field


def build_mesh(spec: VehicleSpec, resolution_m: float = 0.025) -> trimesh.Trimesh:
    """Build a watertight mesh of the vehicle.

    Args:
        spec: the vehicle; the mesh's axis-aligned box has exactly its length, width and height.
        resolution_m: grid spacing, metres; 0.025 shows every part, 0.05 is enough for ray casting from metres away.
    Returns: mesh in the object frame (x forward, y left, z up, origin at the centre of its box), metres.
    Raises: InputError for a spec that cannot be built.
    Differentiable w.r.t.: nothing. Source: our choice: the paper takes its vehicles from ShapeNet.
    """
    spec.validate()
    high = np.array([spec.length_m / 2, spec.width_m / 2, spec.height_m])
    grid = half_grid(high * (-1.0, -1.0, 0.0), high, resolution_m)
    return sized_mesh(mirrored(car_field(grid, spec)), resolution_m, (spec.length_m, spec.width_m, spec.height_m))


def mirrored(half: Array) -> Array:
    """Mirror the field on the half grid (A, B, C) to the whole grid (A, 2 B - 1, C)."""
    return np.concatenate([half[:, :0:-1], half], axis=1)


def sized_mesh(
    field: Array, step_m: float, size_m: tuple[float, float, float], faces: int | None = None
) -> trimesh.Trimesh:
    """Mesh a field on a whole grid, scaled to its stated size and centred at the origin; see `build_mesh`."""
    mesh = _meshed(field, step_m)
    if faces is not None and len(mesh.faces) > faces:
        mesh = _simplified(mesh, faces)
    low, high = mesh.bounds
    mesh.vertices = (mesh.vertices - (low + high) / 2) * (np.array(size_m) / (high - low))
    return mesh


def _meshed(field: Array, step_m: float) -> trimesh.Trimesh:
    """Return the largest surface of a field. Levels at which marching cubes pinches an edge are skipped."""
    for level in LEVELS_M:
        vertices, triangles, _, _ = marching_cubes(field, level, spacing=(step_m,) * 3)
        mesh = trimesh.Trimesh(vertices, triangles[:, ::-1], process=True)
        if mesh.body_count > 1:
            mesh = max(mesh.split(only_watertight=False), key=lambda part: len(part.faces))
        if mesh.volume < 0:
            mesh.invert()
        if mesh.is_watertight:
            break
    return mesh


def _simplified(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    import fast_simplification

    points, triangles = fast_simplification.simplify(
        np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32), target_count=faces, agg=3.0
    )
    simple = trimesh.Trimesh(points, triangles, process=True)
    return simple if simple.is_watertight else mesh
