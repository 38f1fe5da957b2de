"""Repair of a vehicle's mesh to a closed mesh, with a report. A mesh that cannot be closed is refused.

The first steps keep the surface in place: merge vertices, drop degenerate and repeated faces, flip pieces that are
inside out, fill holes of three or four edges. If the mesh then encloses a solid, it is the result. Otherwise a new
surface is wrapped around it (`shift3d.vehicles.wrap`), and the report has the new surface's distance from the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from trimesh.graph import connected_component_labels

from shift3d.errors import InputError
from shift3d.sdf.samples import is_closed, winding_number
from shift3d.vehicles.wrap import nondegenerate_faces, wrapped
from shift3d.wording import counted

SIDED_SHARE = 0.99
"""Minimum share of the surface with outside on its outer and inside on its inner side; below it the mesh is wrapped."""
SOLID_SHARE = 0.15
"""Minimum share of its box that a closed mesh fills. Cars fill 0.4 to 0.65, a pickup on high wheels 0.28."""


@dataclass(frozen=True)
class RepairReport:
    """Defects found in a mesh, and the repairs made.

    watertight: True if the mesh was closed after its vertices were merged. open_edges: edges with only one face then.
    merged_vertices, dropped_faces, flipped_pieces, filled_holes: counts of the repairs. widest_hole_m: width of the
    largest filled hole, which tells a missing floor from a crack.
    wrapped: True if the surface is a new one. seal_m is then the bridged gap width, and departure_m and
    departure_p99_m are the mean and 99th percentile of the surface's distance from the mesh's faces, metres.
    """

    watertight: bool
    open_edges: int
    merged_vertices: int = 0
    dropped_faces: int = 0
    flipped_pieces: int = 0
    filled_holes: int = 0
    widest_hole_m: float = 0.0
    wrapped: bool = False
    seal_m: float = 0.0
    departure_m: float = 0.0
    departure_p99_m: float = 0.0

    def __str__(self) -> str:
        done = [
            f"{counted(count, what)} {how}"
            for count, what, how in (
                (self.dropped_faces, "degenerate or repeated face", "dropped"),
                (self.flipped_pieces, "piece", "turned outside out"),
                (self.filled_holes, "hole", f"filled, the widest {100 * self.widest_hole_m:.1f} cm"),
            )
            if count
        ]
        if self.wrapped:
            done.append(
                f"wrapped (gaps up to {100 * self.seal_m:.0f} cm bridged; {100 * self.departure_m:.1f} cm from "
                f"the mesh on average, 99 % within {100 * self.departure_p99_m:.1f} cm)"
            )
        was = "closed" if self.watertight else f"not closed ({self.open_edges} open edges)"
        return f"{was}; {', '.join(done) or 'nothing to repair'}"


def close_mesh(mesh: trimesh.Trimesh, where: str) -> tuple[trimesh.Trimesh, RepairReport]:
    """Close a vehicle's mesh in the object frame, metres, and report the repairs.

    Returns: a new mesh that `shift3d.sdf.samples.sample_sdf` accepts, normals outwards. The given mesh stays unchanged.
    Raises: InputError naming `where` for a mesh that encloses no solid: a sheet, holes too wide to bridge.
    Source: our choice: the paper is silent; DeepSDF drops shapes whose faces are seen from both sides.
    """
    mesh, report = _cleaned(mesh)
    if not is_closed(mesh):
        mesh, report = _stitched(mesh, report)
    if is_closed(mesh):
        mesh, report = _turned(mesh, report)
        if correctly_oriented_share(mesh) >= SIDED_SHARE:
            share = float(mesh.volume / np.prod(np.ptp(mesh.vertices, axis=0)))
            if share < SOLID_SHARE:
                what = f"the mesh encloses {100 * share:.0f} % of its box, too little for a vehicle"
                raise InputError(what, where=where, remedy="Leave it out: it is a part, a frame or a scene")
            return mesh, report
    outer, seal_m, off = wrapped(mesh, where)
    return outer, replace(
        report,
        wrapped=True,
        seal_m=seal_m,
        departure_m=float(off.mean()),
        departure_p99_m=float(np.quantile(off, 0.99)),
    )


def _cleaned(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, RepairReport]:
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    vertices, faces = len(mesh.vertices), len(mesh.faces)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(nondegenerate_faces(mesh))
    mesh.update_faces(mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    counts = np.bincount(mesh.edges_unique_inverse) if len(mesh.faces) else np.zeros(0, np.int64)
    return mesh, RepairReport(
        watertight=is_closed(mesh),
        open_edges=int((counts == 1).sum()),
        merged_vertices=vertices - len(mesh.vertices),
        dropped_faces=faces - len(mesh.faces),
    )


def _stitched(mesh: trimesh.Trimesh, report: RepairReport) -> tuple[trimesh.Trimesh, RepairReport]:
    """Make the windings consistent within each piece, then fill holes of three or four edges."""
    trimesh.repair.fix_winding(mesh)
    before = _hole_widths_m(mesh)
    trimesh.repair.fill_holes(mesh)
    after = _hole_widths_m(mesh)
    filled = [width for corners, width in before.items() if corners not in after]
    return mesh, replace(report, filled_holes=len(filled), widest_hole_m=max(filled, default=0.0))


def _hole_widths_m(mesh: trimesh.Trimesh) -> dict[frozenset[int], float]:
    """Return the width of every connected run of edges with only one face (normally a hole), by its vertices."""
    single = mesh.edges_unique[np.bincount(mesh.edges_unique_inverse) == 1]
    if not len(single):
        return {}
    labels = connected_component_labels(single, node_count=len(mesh.vertices))
    corners = np.unique(single)
    runs = [corners[labels[corners] == run] for run in np.unique(labels[corners])]
    return {
        frozenset(int(corner) for corner in run): float(np.linalg.norm(np.ptp(mesh.vertices[run], axis=0)))
        for run in runs
    }


def _turned(mesh: trimesh.Trimesh, report: RepairReport) -> tuple[trimesh.Trimesh, RepairReport]:
    """Flip pieces that are inside out, except cavities, which lie within another piece."""
    piece = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.float64), 1, 0)
    volume = np.bincount(piece, weights=np.einsum("ij,ij->i", a, np.cross(b, c)))  # six times the volume
    faces = np.array(mesh.faces)
    flipped = 0
    for index in np.flatnonzero(volume < 0.0):
        rest = trimesh.Trimesh(mesh.vertices, faces[piece != index], process=False)
        corner = mesh.triangles_center[piece == index][:1]
        if len(rest.faces) and abs(winding_number(rest, corner)[0]) > 0.5:
            continue
        faces[piece == index] = faces[piece == index][:, ::-1]
        flipped += 1
    turned = trimesh.Trimesh(mesh.vertices, faces, process=False)
    return turned, replace(report, flipped_pieces=flipped)


def correctly_oriented_share(mesh: trimesh.Trimesh) -> float:
    """Return the share of a closed mesh's area with outside 1 mm outwards and inside 1 mm inwards.

    The share is below one if pieces overlap, a surface lies inside another, or normals point the wrong way.
    """
    points, index = trimesh.sample.sample_surface(mesh, 4000, seed=np.random.default_rng(0))
    normals = np.asarray(mesh.face_normals)[index]
    outer = winding_number(mesh, np.asarray(points) + 1e-3 * normals)
    inner = winding_number(mesh, np.asarray(points) - 1e-3 * normals)
    return float(((outer < 0.5) & (inner > 0.5)).mean())
