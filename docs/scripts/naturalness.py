"""Naturalness of the wide family, the shipped decoder and given shapes, measured against the wide family.

``python docs/scripts/naturalness.py [real=FOLDER ...] [OUT ...] [members=2000] [json=FILE]`` prints figures. real:
folders of meshes in DeepSDF's axes, scaled to 4.5 m. OUT: folders of finished sweeps, whose adversarial shapes are
measured again from their codes. json: file for the figures.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from shift3d.naturalness.build import load_reference
from shift3d.naturalness.calibration import NATURAL_PERCENTILE
from shift3d.naturalness.measure import NaturalnessMeasure, NaturalnessMeter
from shift3d.naturalness.sources import WideReference
from shift3d.store.atomic import write_atomic
from shift3d.vehicles.mesh_files import find_meshes, read_mesh
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.sources import VehicleSet
from shift3d.vehicles.vehicle import family_vehicles

Figures = Iterator[tuple[str, dict[str, Any]]]
REAL = MeshFrame(forward="-z", up="+y", length_m=4.5)
COLUMNS = ("median", "95th percentile", "99th percentile", "at most")


@dataclass(frozen=True)
class Group:
    """Measures of one kind of shapes. seconds: median time for one shape."""

    name: str
    found: list[NaturalnessMeasure]
    seconds: float

    def figures(self) -> Figures:
        """Return the figures of the group."""
        apart = [one.nearest.mean_cm for one in self.found if one.nearest]
        percentiles = [one.percentile for one in self.found]
        yield from _of(self.name, apart, percentiles)
        yield f"{self.name}/natural", {"value": sum(one.natural for one in self.found), "n": len(self.found)}
        yield f"{self.name}/seconds a shape", {"value": self.seconds, "unit": "s"}
        for name, count in Counter(name for one in self.found for name in one.out_of_range).items():
            yield f"{self.name}/out of range {name}", {"value": count, "n": len(self.found)}


def _of(name: str, apart: Sequence[float], percentiles: Sequence[float]) -> Figures:
    number = len(percentiles)
    yield f"{name}/number", {"value": number}
    for column, value in zip(COLUMNS, np.quantile(apart, (0.5, 0.95, 0.99, 1.0))):
        yield f"{name}/{column}", {"value": float(value), "unit": "cm", "n": number}
    yield f"{name}/median percentile", {"value": float(np.median(percentiles)), "unit": "percentile"}
    within = sum(value <= NATURAL_PERCENTILE for value in percentiles)
    yield f"{name}/within the 95th", {"value": within, "n": number}


def measured(name: str, shapes: Iterable[NaturalnessMeasure], total: int) -> Group:
    """Measure every shape of a group."""
    found, seconds = [], []
    shapes = iter(shapes)
    for _ in tqdm(range(total), desc=name, mininterval=5.0):
        start = time.perf_counter()
        found.append(next(shapes))
        seconds.append(time.perf_counter() - start)
    return Group(name, found, float(np.median(seconds)))


def decoder_groups(measures: NaturalnessMeter) -> list[Group]:
    """Measure the shipped baselines and the codes that the decoder was trained on."""
    shipped = VehicleSet()
    decoder = shipped.decoder()
    sets = {
        "shipped baselines": [shipped.vehicle(name) for name in shipped.names()],
        "trained codes": family_vehicles(),
    }
    return [
        measured(name, (measures.of_code(one, decoder, one.latent_code) for one in vehicles), len(vehicles))
        for name, vehicles in sets.items()
    ]


def real_group(measures: NaturalnessMeter, folders: Sequence[str]) -> Group:
    """Measure the meshes of folders, each scaled to 4.5 m."""
    files = [file for folder in folders for file in find_meshes(folder)]
    shapes = (measures.of(REAL.to_object(read_mesh(file.path), str(file.path))) for file in files)
    return measured("real cars, scaled to 4.5 m", shapes, len(files))


def sweep_groups(measures: NaturalnessMeter, outs: Sequence[str]) -> list[Group]:
    """Measure the adversarial shapes of finished sweeps, by lambda."""
    shipped = VehicleSet()
    decoder = shipped.decoder()
    frames = [pd.read_parquet(Path(out) / "final" / "solutions.parquet") for out in outs]
    rows = pd.concat(frames) if frames else pd.DataFrame()
    groups = []
    if len(rows):
        rows = rows[(rows["method"] == "adversarial") & (rows["mode"] != "pose")].drop_duplicates("task_id")
        for weight, part in rows.groupby("lambda"):
            codes = zip(part["vehicle"], part["latent_code"])
            shapes = (
                measures.of_code(shipped.vehicle(name), decoder, np.asarray(code, np.float32)) for name, code in codes
            )
            groups.append(measured(f"adversarial, lambda {weight:g}", shapes, len(part)))
    return groups


def left_out(measures: NaturalnessMeter) -> Figures:
    """Return the figures of the calibration itself: members left out of the reference set."""
    known = measures.reference.calibration
    return _of(
        "members left out", known.mean_cm, [known.percentile(*pair) for pair in zip(known.mean_cm, known.p95_cm)]
    )


def main(arguments: list[str]) -> None:
    """Print the figures and write them."""
    torch.set_num_threads(1)
    given = [word.split("=", 1) for word in arguments if "=" in word]
    real = [value for name, value in given if name == "real"]
    options = dict(given)
    source = WideReference(int(options.get("members", WideReference.members_count)))
    measures = NaturalnessMeter(load_reference(source, "members"))
    groups = decoder_groups(measures)
    groups += [real_group(measures, real)] if real else []
    groups += sweep_groups(measures, [word for word in arguments if "=" not in word])
    figures = dict(left_out(measures))
    for group in groups:
        figures |= dict(group.figures())
    text = json.dumps(figures, indent=1) + "\n"
    if "json" in options:
        write_atomic(Path(options["json"]), text.encode())
    print(text, end="")


if __name__ == "__main__":
    main(sys.argv[1:])
