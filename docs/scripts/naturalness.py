"""What naturalness comes to: the wide family, the shipped decoder, and what is given, against the wide family.

``python docs/scripts/naturalness.py [real=FOLDER ...] [OUT ...] [members=2000] [json=FILE]`` prints a Markdown table.
real: folders of meshes in DeepSDF's axes, scaled to 4.5 m. OUT: folders of finished sweeps; their adversarial shapes
are measured again from their codes. json: a file that the numbers are written to, with their commit and command.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from tqdm import tqdm

from shift3d.naturalness.build import load_reference
from shift3d.naturalness.calibration import NATURAL_PERCENTILE
from shift3d.naturalness.measure import Naturalness, NaturalnessMeasure
from shift3d.naturalness.sources import WideReference
from shift3d.store.atomic import write_atomic
from shift3d.vehicles.mesh_files import find_meshes, read_mesh
from shift3d.vehicles.mesh_frame import MeshFrame
from shift3d.vehicles.sources import VehicleSet
from shift3d.vehicles.vehicle import family_vehicles

REAL = MeshFrame(forward="-z", up="+y", length_m=4.5)
HEADER = ("shapes", "number", "median", "95th percentile", "99th percentile", "at most", "percentile", "within 95th",
          "natural")  # fmt: skip


@dataclass(frozen=True)
class Group:
    """Measures of one kind of shapes. seconds: for one of them, in the median."""

    name: str
    found: list[NaturalnessMeasure]
    seconds: float

    def row(self) -> list[str]:
        """Cells of the table."""
        apart = [one.nearest.mean_cm for one in self.found if one.nearest]
        within = sum(one.percentile <= NATURAL_PERCENTILE for one in self.found)
        natural = sum(one.natural for one in self.found)
        quantiles = [f"{value:.1f}" for value in np.quantile(apart, (0.5, 0.95, 0.99, 1.0))]
        middle = f"{np.median([one.percentile for one in self.found]):.0f}"
        return [self.name, str(len(self.found)), *quantiles, middle, str(within), str(natural)]


def measured(name: str, shapes: Iterable[NaturalnessMeasure], total: int) -> Group:
    """Measure every shape of a group."""
    found, seconds = [], []
    shapes = iter(shapes)
    for _ in tqdm(range(total), desc=name, mininterval=5.0):
        start = time.perf_counter()
        found.append(next(shapes))
        seconds.append(time.perf_counter() - start)
    return Group(name, found, float(np.median(seconds)))


def decoder_groups(measures: Naturalness) -> list[Group]:
    """The shipped baselines and the codes that the decoder was trained on."""
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


def real_group(measures: Naturalness, folders: Sequence[str]) -> Group:
    """Meshes of folders, each scaled to 4.5 m."""
    files = [file for folder in folders for file in find_meshes(folder)]
    shapes = (measures.of(REAL.to_object(read_mesh(file.path), str(file.path))) for file in files)
    return measured("real cars, scaled to 4.5 m", shapes, len(files))


def sweep_groups(measures: Naturalness, outs: Sequence[str]) -> list[Group]:
    """Adversarial shapes of finished sweeps, by lambda."""
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


def left_out_row(measures: Naturalness) -> list[str]:
    """The calibration itself as a row."""
    apart = measures.reference.calibration.mean_cm
    quantiles = [f"{value:.1f}" for value in np.quantile(apart, (0.5, 0.95, 0.99, 1.0))]
    own = [
        measures.reference.calibration.percentile(*pair) for pair in zip(apart, measures.reference.calibration.p95_cm)
    ]
    within = sum(value <= NATURAL_PERCENTILE for value in own)
    return ["members left out", str(len(apart)), *quantiles, f"{np.median(own):.0f}", str(within), ""]


def write_json(path: Path, measures: Naturalness, groups: Sequence[Group], command: str) -> None:
    """Numbers with their unit, commit and command."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True)
    stamp = {"commit": commit.stdout.strip(), "command": command}
    values = {"members_left_out": measures.reference.calibration.mean_cm}
    for group in groups:
        apart = [one.nearest.mean_cm for one in group.found if one.nearest]
        values[group.name.replace(",", "").replace(" ", "_")] = np.array(apart)
    numbers = {
        f"{name}_median": {
            "value": round(float(np.median(apart)), 3),
            "unit": "cm",
            "interval": [round(float(low), 3) for low in np.quantile(apart, (0.05, 0.95))],
            **stamp,
        }
        for name, apart in values.items()
    }
    write_atomic(path, (json.dumps(numbers, indent=1) + "\n").encode())


def main(arguments: list[str]) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    given = [word.split("=", 1) for word in arguments if "=" in word]
    real = [value for name, value in given if name == "real"]
    options = dict(given)
    source = WideReference(int(options.get("members", WideReference.members_count)))
    measures = Naturalness(load_reference(source, "members"))
    groups = decoder_groups(measures)
    groups += [real_group(measures, real)] if real else []
    groups += sweep_groups(measures, [word for word in arguments if "=" not in word])
    rows = [HEADER, ["---"] * len(HEADER), left_out_row(measures), *(group.row() for group in groups)]
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))
    for group in groups:
        odd = pd.Series([name for one in group.found for name in one.out_of_range]).value_counts().to_dict()
        print(f"{group.name}: {group.seconds:.2f} s a shape; out of range: {odd or 'none'}")
    if "json" in options:
        # Not where the folders lie on this machine.
        words = [f"{word.split('=')[0]}=FOLDER" if word.startswith("real=") else word for word in arguments]
        words = [word if "=" in word else "OUT" for word in words if not word.startswith("json=")]
        write_json(Path(options["json"]), measures, groups, " ".join(["python docs/scripts/naturalness.py", *words]))


if __name__ == "__main__":
    main(sys.argv[1:])
