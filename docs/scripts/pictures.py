"""Pictures of README and docs, drawn from shipped files and from finished sweeps.

``python docs/scripts/pictures.py OUT ... [task=ID] [folder=FOLDER]``: OUTs are folders of sweeps against one detector,
for example one of shapes and one of poses. ID selects the task in the picture; the default is the task with a natural
shape whose score falls furthest. FOLDER (docs/pictures) receives the PNGs.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from shift3d.errors import InputError
from shift3d.wording import counted

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from shift3d.task.assets import Assets

__all__ = ["draw_case", "draw_effects", "draw_family", "draw_random_codes", "draw_training"]

_RED = (0.75, 0.3, 0.27)
_SIDE, _THREE_QUARTERS = (np.pi / 2, 0.05), (0.7, 0.3)


def _figure(width: float, height: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def draw_family(path: Path, columns: int = 6) -> None:
    """Draw one vehicle of every body type and attribute of the wide family: seen ones blue, held-out ones red."""
    from shift3d.vehicles.family.split import SPLIT

    sides = {"seen in training": SPLIT.seen, "held out": SPLIT.held_out}
    bands = [-(-len(names) // columns) for names in sides.values()]
    figure = _figure(12, 1.6 * sum(bands))
    parts: list[Any] = list(np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=bands))))
    for part, (title, names), rows in zip(parts, sides.items(), bands):
        part.suptitle(title, fontsize=10, x=0.01, ha="left", weight="bold")
        panels = part.subplots(rows, columns, squeeze=False).flat
        for panel in panels:
            panel.set_axis_off()
        for panel, name in zip(part.axes, names):
            _draw_kind(panel, name, None if names is SPLIT.seen else _RED)
    figure.savefig(path)


_SHOWN_ON = {
    "roof_box": "beach_wagon",
    "tail_bicycles": "hatchback",
    "open_tailgate": "suv",
    "dented": "sedan",
    "missing_panels": "sedan",
}
"""Body types that show an attribute well. Other attributes use the first body type that carries them."""
_FROM_BEHIND = ("spare_wheel", "canopy", "tail_bicycles", "open_tailgate")
_DRAW = {"dented": 20, "missing_panels": 12}
"""Number of the draw to show; the default is the first. For damage: a draw on the side that the picture shows."""
_FROM_ABOVE = ("roof_rack", "ladder", "roof_rails", "roof_box")


def _draw_kind(panel: Axes, name: str, rgb: tuple[float, float, float] | None) -> None:
    """Draw one vehicle of a body type, or one with an attribute."""
    from shift3d.seeding import generator
    from shift3d.vehicles.family.attributes import ATTRIBUTES
    from shift3d.vehicles.family.wide import build_wide_mesh, draw_wide
    from shift3d.vehicles.picture import BODY_RGB, shaded

    attributes = (name,) if name in ATTRIBUTES else ()
    body_type = _SHOWN_ON.get(name, ATTRIBUTES[name].carriers[0]) if attributes else name
    spec = draw_wide(body_type, attributes, generator("family picture", name, _DRAW.get(name, 0)))
    azimuth = np.pi - 0.7 if name in _FROM_BEHIND else 0.75
    elevation = 0.42 if name in _FROM_ABOVE else 0.27
    span_m = 6.0 if spec.size_m[0] < 6.0 else 8.9
    picture = shaded(build_wide_mesh(spec), azimuth, elevation, 400, 230, span_m, rgb or BODY_RGB)
    panel.imshow(picture)
    size = " x ".join(f"{side:.2f}" for side in spec.size_m)
    panel.set_title(f"{spec.kind.replace('_', ' ').replace('+', ' + ')}\n{size} m", fontsize=8)


def draw_random_codes(path: Path, count: int = 40, columns: int = 8) -> None:
    """Draw random codes of the parametric decoder: random kinds with random parameters in their ranges.

    Below each: its distance from the nearest known vehicle and the percentile of that distance; red if not natural.
    """
    import torch

    from shift3d.attack.space import parameter_space
    from shift3d.naturalness.build import load_reference
    from shift3d.naturalness.measure import NaturalnessMeter
    from shift3d.naturalness.sources import WideReference
    from shift3d.seeding import generator
    from shift3d.vehicles.picture import BODY_RGB, shaded
    from shift3d.vehicles.sources import WIDE, VehicleSet
    from shift3d.vehicles.vehicle import vehicle_mesh

    vehicles = VehicleSet(WIDE)
    decoder, names, rng = vehicles.decoder(), vehicles.names(), generator("random codes picture")
    measures = NaturalnessMeter(load_reference(WideReference(), "naturalness"))
    figure = _figure(15, 1.55 * (count // columns))
    for panel in figure.subplots(count // columns, columns).flat:
        name = names[rng.integers(len(names))]
        vehicle = vehicles.vehicle(name)
        space = parameter_space(torch.from_numpy(vehicle.latent_code), vehicles.parameters(name))
        code = space.code(space.draw(rng, 0.0)).float()
        found = measures.of_code(vehicle, decoder, code)
        drawn = replace(vehicle, latent_code=code.numpy())
        mesh = vehicle_mesh(drawn, decoder, resolution=160)
        span_m = 6.0 if np.ptp(mesh.vertices[:, 0]) < 6.0 else 8.9
        panel.imshow(shaded(mesh, 0.75, 0.3, 400, 230, span_m, BODY_RGB if found.natural else _RED))
        panel.set_axis_off()
        distance = "" if found.nearest is None else f"{found.nearest.mean_cm:.1f} cm, {found.percentile:.0f} %"
        panel.set_title(f"{name.replace('_', ' ')}\n{distance}", fontsize=7)
    figure.savefig(path)


def draw_case(assets: Assets, spec: Any, solutions: pd.DataFrame, scores: pd.DataFrame, path: Path) -> None:
    """Draw one task before and after: the vehicle, the points that the detector sees, and the score.

    solutions, scores: the task's rows, replicate 0.
    """
    from shift3d.vehicles.picture import shaded
    from shift3d.vehicles.vehicle import vehicle_mesh

    figure = _figure(11, 4.6)
    axes = figure.subplots(2, 2, width_ratios=(1, 1.6))
    vehicle = assets.vehicle(spec)
    for row, (method, rgb) in enumerate((("baseline", (0.28, 0.47, 0.66)), ("adversarial", _RED))):
        solution = solutions[solutions["method"] == method].iloc[0]
        score = float(scores[scores["method"] == method].iloc[0]["score"])
        mesh = vehicle_mesh(vehicle, assets.decoder, np.asarray(solution["latent_code"], np.float32), resolution=224)
        # A shape is drawn from one side, a pose from the sensor.
        azimuth = 0.9 if spec.mode == "shape" else _azimuth_of_sensor(solution)
        axes[row, 0].imshow(shaded(mesh, azimuth, 0.25, width_px=520, height_px=300, rgb=rgb))
        axes[row, 0].set_axis_off()
        weight = f", lambda {spec.lambda_:g}" if method == "adversarial" and spec.lambda_ is not None else ""
        axes[row, 0].set_title(f"{spec.vehicle.replace('_', ' ')}, {method}{weight}", fontsize=9)
        _draw_points(axes[row, 1], assets, spec, solution)
        axes[row, 1].set_title(f"score {score:.2f}", fontsize=9)
    figure.savefig(path)


def _azimuth_of_sensor(solution: pd.Series) -> float:
    """Return the direction from object to sensor, counter-clockwise from the nose, radians."""
    return float(np.arctan2(-solution["y_m"], -solution["x_m"]) - solution["yaw_rad"])


def _draw_points(axes: Axes, assets: Assets, spec: Any, solution: pd.Series) -> None:
    """Draw the rendered scene around the object from the sensor's height, the object's points in colour."""
    from shift3d.task.follow_ups.rendered import render_solution

    found = render_solution(spec, solution.to_dict(), assets)
    theta, rendering = found.theta, found.rendering
    points, hits = rendering.points.double().numpy(), rendering.hit_mask.numpy()
    image, depth = _from_above(points, theta.numpy())
    near = (np.abs(points[:, :2] - theta[:2].numpy()) < 12.0).all(axis=1) & (depth > 0.5)
    for rows, colour, size in ((near & ~hits, "#9a9a9a", 0.6), (near & hits, "#c03030", 1.6)):
        axes.scatter(image[rows, 0], image[rows, 1], s=size, c=colour, lw=0)
    axes.set_aspect("equal")
    axes.set_xlim(-0.42, 0.42)
    axes.set_ylim(-0.22, 0.2)
    axes.set_axis_off()


def _from_above(points: NDArray[np.float64], theta: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Project points to a perspective image (N, 2) and depths (N,), from 11 m before the object and 4 m above it."""
    towards = theta[:2] / np.hypot(*theta[:2])
    eye = np.array([*(theta[:2] - 11.0 * towards), theta[2] + 4.0])
    forward = theta[:3] - eye
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right = right / np.linalg.norm(right)
    seen = (points - eye) @ np.stack((right, np.cross(right, forward), forward)).T
    return seen[:, :2] / np.maximum(seen[:, 2:], 1e-3), seen[:, 2]


def draw_training(path: Path) -> None:
    """Draw each detector's recorded losses, over the crops of its last training that was not of the heads alone."""
    import json

    from shift3d.detectors.models.weights import WEIGHTS_FOLDER
    from shift3d.detectors.names import DETECTOR_NAMES

    figure = _figure(11, 2.8)
    panels = dict(zip(("class", "box", "direction"), figure.subplots(1, 3)))
    for number, name in enumerate(DETECTOR_NAMES):
        file = WEIGHTS_FOLDER / f"{name}.json"
        facts = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        while facts.get("recipe", {}).get("steps") == 0:
            facts = facts["before"]
        for loss, panel in panels.items():
            if "curve" in facts and loss in facts["curve"][0]:
                crops = [point["step"] * facts["recipe"]["batch"] for point in facts["curve"]]
                losses = [point[loss] for point in facts["curve"]]
                panel.plot(crops, losses, lw=1.2, color=f"C{number}", label=name.replace("_", ", "))
    for loss, panel in panels.items():
        panel.set_title(f"{loss} loss, training crops", fontsize=9)
        panel.set_yscale("log")  # losses of heat maps and of anchors differ by their units
        panel.set_yticks(
            [tick for tick in (0.2, 0.3, 0.5, 0.7, 1, 2, 5) if panel.get_ylim()[0] < tick < panel.get_ylim()[1]]
        )
        panel.yaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_minor_formatter("")
    panels["class"].legend(fontsize=8, frameon=False)
    figure.supxlabel("crops", fontsize=9)
    figure.savefig(path)


def draw_effects(path: Path) -> None:
    """Draw impact and cost of each effect, as `effects=auto` reads them."""
    from shift3d.analysis.figures.sweep import effects_figure
    from shift3d.effects.applicability import measured_impact

    effects_figure(measured_impact()).savefig(path, dpi=110, metadata={"Software": None})


def _hardest_natural(scores: pd.DataFrame) -> str:
    """Return the id of the task whose score fell furthest, among tasks with a natural shape."""
    from shift3d.analysis.results import natural_by_task

    first = scores[scores["replicate"] == 0]
    table = first.pivot(index="task_id", columns="method", values="score").dropna()
    verdicts = natural_by_task(scores)
    cars = table[[verdicts.get(task, False) for task in table.index]]
    if cars.empty:
        raise InputError("no adversarial shape is natural", "final/scores.parquet", "Give the sweep a larger lambda")
    return str((cars["adversarial"] - cars["baseline"]).idxmin())


def main(arguments: list[str]) -> None:
    """Draw every picture from the sweeps in ``arguments``."""
    import pandas as pd

    from shift3d.sweep.planning.folder import read_plan
    from shift3d.task.assets import load_assets

    given = dict(word.split("=", 1) for word in arguments if word.startswith(("task=", "folder=")))
    outs = [Path(word) for word in arguments if not word.startswith(("task=", "folder="))]
    if not outs:
        raise SystemExit("usage: python docs/scripts/pictures.py OUT ... [task=ID] [folder=FOLDER]")
    folder = Path(given.get("folder", "docs/pictures"))
    for out in outs:
        if not (out / "final" / "scores.parquet").is_file():
            raise InputError("no finished sweep", str(out), "Run make sweep first")
    folder.mkdir(parents=True, exist_ok=True)
    draw_family(folder / "family.png")
    draw_random_codes(folder / "random_codes.png")
    draw_training(folder / "training.png")
    draw_effects(folder / "effects.png")
    tables = {
        name: pd.concat([pd.read_parquet(out / "final" / f"{name}.parquet") for out in outs], ignore_index=True)
        for name in ("scores", "solutions", "auc")
    }
    # The scores of the attacked detector; other detectors may have scored the same objects.
    for name in ("scores", "auc"):
        tables[name] = tables[name][tables[name]["scored_by"] == tables[name]["detector"]]
    shown = given.get("task") or _hardest_natural(tables["scores"])
    found = [(plan, task) for plan in map(read_plan, outs) for task in plan.tasks.starting_with(shown)]
    if len(found) != 1:
        raise InputError(
            f"{counted(len(found), 'task')} with an id that begins with {shown}", "task=", "Give one of final/scores"
        )
    plan, task = found[0]
    own = {name: tables[name][tables[name]["task_id"] == task.spec.task_id] for name in ("solutions", "scores")}
    draw_case(load_assets(plan.assets[task.assets]), task.spec, own["solutions"], own["scores"], folder / "case.png")


if __name__ == "__main__":
    main(sys.argv[1:])
