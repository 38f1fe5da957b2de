"""A vehicle's mesh made closed, with a report of what was done to it; what cannot be closed is refused.

First what leaves the surface where it is: merging vertices, dropping degenerate and repeated faces, turning pieces
that are inside out, filling holes of three or four edges. If the mesh then encloses a solid it is used as it is.
Otherwise a new surface is wrapped around it (see `shift3d.vehicles.wrap`), and the report says how far off it is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from trimesh.graph import connected_component_labels

from shift3d.errors import InputError
from shift3d.sdf.samples import is_closed, winding_number
from shift3d.vehicles.wrap import uncollapsed, wrapped
from shift3d.wording import counted

SIDED_SHARE = 0.99
"""Share of the surface that must have outside on its outer and inside on its inner side, not to be wrapped."""
SOLID_SHARE = 0.15
"""Least share of its box that a closed mesh fills. Cars fill 0.4 to 0.65, a pickup on high wheels 0.28."""


@dataclass(frozen=True)
class RepairReport:
    """What was found and done.

    watertight: whether the mesh was closed as it came, vertices merged. open_edges: edges of only one face then.
    merged_vertices, dropped_faces, flipped_pieces, filled_holes: counts of the repairs. widest_hole_m: across the
    largest that was filled, so that a missing floor is not taken for a crack.
    wrapped: whether the surface is a new one; then seal_m is how wide the gaps are that it bridges, and departure_m
    and departure_p99_m the mean and 99th percentile of its distance from the mesh's faces, metres.
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


def repaired(mesh: trimesh.Trimesh, where: str) -> tuple[trimesh.Trimesh, RepairReport]:
    """A closed mesh for a vehicle's mesh in the object frame, metres, and what it took.

    Returns: a new mesh that `shift3d.sdf.samples.sample_sdf` takes, normals outwards; the given one is not changed.
    Raises: InputError naming `where` for what encloses no solid: a sheet, holes too wide to bridge.
    Source: our choice: the paper is silent; DeepSDF drops shapes whose faces are seen from both sides.
    """
    mesh, report = _cleaned(mesh)
    if not is_closed(mesh):
        mesh, report = _stitched(mesh, report)
    if is_closed(mesh):
        mesh, report = _turned(mesh, report)
        if sided_share(mesh) >= SIDED_SHARE:
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
    mesh.update_faces(uncollapsed(mesh))
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
    """Windings made one within each piece, then holes of three or four edges filled."""
    trimesh.repair.fix_winding(mesh)
    before = _hole_widths_m(mesh)
    trimesh.repair.fill_holes(mesh)
    after = _hole_widths_m(mesh)
    filled = [width for corners, width in before.items() if corners not in after]
    return mesh, replace(report, filled_holes=len(filled), widest_hole_m=max(filled, default=0.0))


def _hole_widths_m(mesh: trimesh.Trimesh) -> dict[frozenset[int], float]:
    """Width of every connected run of edges with only one face (a hole, if nothing is odd), by its vertices."""
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
    """Pieces that are inside out turned, unless they are cavities: those lie within another piece."""
    piece = connected_component_labels(mesh.face_adjacency, node_count=len(mesh.faces))
    a, b, c = np.moveaxis(np.asarray(mesh.triangles, np.float64), 1, 0)
    volume = np.bincount(piece, weights=np.einsum("ij,ij->i", a, np.cross(b, c)))  # six times, about the origin
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


def sided_share(mesh: trimesh.Trimesh) -> float:
    """Share of a closed mesh's area with outside a millimetre outwards and inside a millimetre inwards.

    Less than one where pieces overlap, a surface lies inside another, or normals point the wrong way.
    """
    points, index = trimesh.sample.sample_surface(mesh, 4000, seed=np.random.default_rng(0))
    normals = np.asarray(mesh.face_normals)[index]
    outer = winding_number(mesh, np.asarray(points) + 1e-3 * normals)
    inner = winding_number(mesh, np.asarray(points) - 1e-3 * normals)
    return float(((outer < 0.5) & (inner > 0.5)).mean())
