"""Distance of a sweep's shapes from real cars, compared with the wide family that the sweep searches in.

``python docs/scripts/near_real_cars.py OUT real=FOLDER [real=FOLDER ...] [members=200] [json=FILE]``: OUT is the folder
of a finished sweep of shapes; the real folders hold meshes in DeepSDF's axes. Every shape, real or not, is scaled to
4.5 m from nose to tail, because DeepSDF meshes have no length in metres.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from tqdm import tqdm

from shift3d.analysis.cases.rendered import PageCache
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.naturalness.build import load_reference
from shift3d.naturalness.reference import ReferenceSet
from shift3d.naturalness.sources import Build, MeshReference, WideReference
from shift3d.naturalness.surface import surface_of_mesh
from shift3d.store.atomic import write_atomic
from shift3d.vehicles.mesh_frame import MeshFrame

LENGTH_M = 4.5
_RESOLUTION = 129
_DRAWS = 2000
METHODS = {"baseline": "baselines", "random_budget": "best of random draws", "adversarial": "found by the search"}
Figures = Iterator[tuple[str, dict[str, Any]]]


@dataclass(frozen=True)
class RealCars:
    """Reference set of the meshes of several folders, see `naturalness.sources.ReferenceSource`."""

    folders: tuple[str, ...]

    def _parts(self) -> list[MeshReference]:
        frame = MeshFrame(forward="-z", up="+y", length_m=LENGTH_M)
        return [MeshReference(folder, frame) for folder in self.folders]

    def identity(self) -> dict[str, Any]:
        """Return everything that determines the set."""
        return {"kind": "folders", "parts": [part.identity() for part in self._parts()]}

    def members(self) -> Sequence[Build]:
        """Return functions that build the members, one each."""
        return [build for part in self._parts() for build in part.members()]


def distance_cm(reference: ReferenceSet, mesh: trimesh.Trimesh) -> float:
    """Compute the mean distance of a mesh, scaled to 4.5 m, from the nearest member, centimetres."""
    scaled = mesh.copy()
    scaled.apply_scale(LENGTH_M / float(np.ptp(scaled.vertices[:, 0])))
    return reference.nearest(surface_of_mesh(scaled)).mean_cm


def family(reference: ReferenceSet, count: int) -> list[float]:
    """Compute the distances of members of the wide family, from both sides of its split."""
    builds = WideReference(count).members()
    return [distance_cm(reference, build()[1]) for build in tqdm(builds, desc="family", mininterval=5.0)]


def solutions(reference: ReferenceSet, sweep: Sweep) -> dict[str, list[float]]:
    """Compute the distances of a sweep's shapes by space/method. Equal shapes count once."""
    loaded, found = PageCache(sweep.plan), dict[str, dict[bytes, float]]()
    rows = [row for row in sweep.solutions.to_dict("records") if row["method"] in METHODS and row["replicate"] == 0]
    for row in tqdm(rows, desc="solutions", mininterval=5.0):
        (task,) = sweep.plan.tasks.starting_with(row["task_id"])
        mesh = loaded.mesh(task, row, _RESOLUTION)
        known = found.setdefault(f"{task.spec.attack.space}/{METHODS[row['method']]}", {})
        key = mesh.vertices.tobytes()
        if key not in known:
            known[key] = distance_cm(reference, mesh)
    return {name: list(distances.values()) for name, distances in found.items()}


def figures(name: str, found: Iterable[float], beside: Sequence[float] | None = None) -> Figures:
    """Yield median and spread of a group. beside: group whose median is subtracted, with intervals by resampling."""
    apart = np.array(list(found))
    yield f"{name}/number", {"value": len(apart)}
    for column, share in {"median": 0.5, "95th percentile": 0.95}.items():
        yield f"{name}/{column}", {"value": float(np.quantile(apart, share)), "unit": "cm", "n": len(apart)}
    if beside is not None:
        other, rng = np.array(beside), np.random.default_rng(0)
        drawn = [
            np.median(rng.choice(apart, len(apart))) - np.median(rng.choice(other, len(other))) for _ in range(_DRAWS)
        ]
        low, high = np.quantile(drawn, (0.025, 0.975))
        value = float(np.median(apart) - np.median(other))
        yield f"{name}/less members", {"value": value, "unit": "cm", "interval": [float(low), float(high)]}


def main(arguments: list[str]) -> None:
    """Print the figures and write them."""
    given = [word.split("=", 1) for word in arguments if "=" in word]
    (out,) = (word for word in arguments if "=" not in word)
    options = dict(given)
    reference = load_reference(RealCars(tuple(value for name, value in given if name == "real")), "real")
    members = family(reference, int(options.get("members", 200)))
    text = dict(figures("members", members))
    for name, found in solutions(reference, read_sweep(out)).items():
        text |= dict(figures(name, found, members))
    written = json.dumps({f"real cars/{name}": value for name, value in text.items()}, indent=1) + "\n"
    if "json" in options:
        write_atomic(Path(options["json"]), written.encode())
    print(written, end="")


if __name__ == "__main__":
    main(sys.argv[1:])
