"""Section of the hard cases: the largest score falls in 3D and from above, with measures and an export command."""

from __future__ import annotations

import math

import numpy as np

from shift3d.analysis.cases.rendered import PageCache, Rendered, rerender
from shift3d.analysis.cases.selection import Case, hardest
from shift3d.analysis.html.blocks import Article, Block, Collapsible, Command, Paragraph, Terms, missing
from shift3d.analysis.html.scene_figures import paired_3d_views, top_views
from shift3d.analysis.html.sections.paths import case_path
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.patterns import NAMES
from shift3d.analysis.tables.table import Table
from shift3d.errors import InputError
from shift3d.geometry.se3 import wrap_angle
from shift3d.task.spec import TaskSpec
from shift3d.vehicles.mesh_measures import DEFINITIONS, Measures
from shift3d.wording import counted


def hard_cases(sweep: Sweep, loaded: PageCache, count: int = 4) -> list[Block]:
    """Build the section: the most harmful solutions rendered again. A case that cannot be loaded is only named."""
    unnatural = sweep.unnatural
    chosen = hardest(sweep.scores, count, unnatural)
    if not chosen:
        return [missing("No score is 0.01 or more below its baseline, so there is no hard case to show.")]
    parts: list[Block] = []
    for number, case in enumerate(chosen, start=1):
        try:
            parts.append(_case(sweep, case, number, loaded))
        except InputError as error:
            parts.append(missing(f"Case {number}, task {case.task_id}, cannot be drawn: {error.what}"))
    lead = (
        f"{counted(len(chosen), 'solution')} with the largest score drops from the baseline of the same task; "
        f"new vehicles and scenes are preferred.{_left_out(unnatural, chosen)} Drag a vehicle to turn both."
    )
    return [Paragraph(lead), *parts, Collapsible("How the meshes are measured", [Terms(DEFINITIONS)])]


def _left_out(unnatural: set[str], chosen: list[Case]) -> str:
    shown = sum(case.task_id in unnatural for case in chosen)
    if not unnatural:
        return ""
    if not shown:
        return f" Unnatural shapes ({counted(len(unnatural), 'task')}) are left out: they are easy to miss."
    which = "The last one is" if shown == 1 else f"The last {shown} are"
    return f" {which} unnatural, because too few scores of other shapes fell."


def _case(sweep: Sweep, case: Case, number: int, loaded: PageCache) -> Article:
    (task,) = sweep.plan.tasks.starting_with(case.task_id)
    both = [row.to_dict() for row in sweep.pair_of(case.task_id)]
    centre = np.mean([[row["x_m"], row["y_m"]] for row in both], axis=0)
    before, after = (rerender(task, row, centre, loaded) for row in both)
    key = f"case-{number}"
    path = case_path(key, sweep.trajectories[sweep.trajectories["task_id"] == case.task_id])
    views, buttons = paired_3d_views(key, case, before, after)
    name = f"{sweep.vehicle_words(case.task_id)}, {case.mode.replace('_', ' and ')}"
    return Article(
        key,
        f"{number}. {name}: score {case.before:.2f} → {case.after:.2f}",
        [
            Paragraph(what_changed(case, before, after)),
            views,
            buttons,
            top_views(key, case, before, after, centre),
            Collapsible("Measures, search steps and settings", [*_measures(case, number, before, after), path,
                 Paragraph(_settings(case, task.spec)), Paragraph(_scored_again(case, before, after))]),
            Command("Export this case (OUT is this page's folder):",
                    f"shift3d export OUT task={case.task_id} method=adversarial to=hard_case_{number}"),
        ],
    )  # fmt: skip


def what_changed(case: Case, before: Rendered, after: Rendered) -> str:
    """Describe the change of shape, place or both."""
    if case.mode == "pose":
        return f"What changed: {_moved(before, after)}; the shape is the baseline's."
    shape = describe_changes(before.measures, after.measures)
    return f"What changed: {shape}" + (f" Its pose: {_moved(before, after)}." if case.mode == "shape_pose" else "")


def _settings(case: Case, spec: TaskSpec) -> str:
    weight = "" if spec.lambda_ is None else f", lambda {spec.lambda_:g}"
    effects = f"effects {', '.join(spec.effects)}" if spec.effects else "no effects"
    return f"Scene {case.scene}, attacked detector {spec.detector}{weight}, {effects}."


def _moved(before: Rendered, after: Rendered) -> str:
    """Describe the change of pose in the vehicle's own axes."""
    shift, yaw = after.theta[:2] - before.theta[:2], before.theta[3]
    forward = 100.0 * float(shift @ [math.cos(yaw), math.sin(yaw)])
    left = 100.0 * float(shift @ [-math.sin(yaw), math.cos(yaw)])
    turn = math.degrees(wrap_angle(float(after.theta[3] - yaw)))
    pitch, roll = (math.degrees(float(after.theta[i] - before.theta[i])) for i in (4, 5))
    return (
        f"moved {abs(forward):.0f} cm {'forward' if forward >= 0 else 'back'} and {abs(left):.0f} cm to the "
        f"{'left' if left >= 0 else 'right'}, turned {abs(turn):.0f}° to the {'left' if turn >= 0 else 'right'}, nose "
        f"{abs(pitch):.1f}° {'down' if pitch >= 0 else 'up'}, left side {abs(roll):.1f}° "
        f"{'up' if roll >= 0 else 'down'}"
    )


def _measures(case: Case, number: int, before: Rendered, after: Rendered) -> list[Block]:
    if case.mode == "pose":
        return []
    header = ["measure", "baseline", "adversarial", "change"]
    lines = change_lines(before.measures, after.measures)
    return [Table(f"Case {number}, measured on the meshes", header, lines)]


def _scored_again(case: Case, before: Rendered, after: Rendered) -> str:
    """State whether the pictures reproduce the sweep's scores."""
    off = max(abs(before.score - case.before), abs(after.score - case.after))
    if off <= 1e-6:
        return f"Task {case.task_id}. Scored again for this page: equal to the sweep's scores to 1e-6."
    scores = f"Scored again for this page: {before.score:.4f} and {after.score:.4f}, up to {off:.1e} off the sweep's."
    why = " Another program version ran the sweep, or this machine rounds differently." if off > 1e-3 else ""
    return f"Task {case.task_id}. {scores}{why}"


# Phrases for less and more, and the least change to mention; smaller changes are artefacts of the mesh grid.
_WORDS = {
    "length_cm": ("{} cm shorter", "{} cm longer", 1.0),
    "height_cm": ("{} cm lower", "{} cm higher", 1.0),
    "width_cm": ("{} cm narrower", "{} cm wider", 1.0),
    "clearance_cm": ("underside {} cm nearer to the ground", "underside {} cm farther from the ground", 1.0),
    "nose_cm": ("nose {} cm lower", "nose {} cm higher", 1.0),
    "tail_cm": ("tail {} cm lower", "tail {} cm higher", 1.0),
    "bonnet_cm": ("bonnet {} cm shorter", "bonnet {} cm longer", 1.0),
    "windshield_deg": ("windshield {}° flatter", "windshield {}° steeper", 1.0),
}


def change_lines(before: Measures, after: Measures) -> list[list[str]]:
    """Build table lines: measure, baseline, adversarial, change, with a decimal at least to show small changes."""
    lines = []
    for field, (name, unit, least_digits) in NAMES.items():
        digits = max(1, least_digits) if unit else least_digits
        old, new = getattr(before, field), getattr(after, field)
        change = "-" if old is None or new is None else f"{_signed(new - old, digits)} {unit}".strip()
        lines.append([name, *(_with_unit(value, unit, digits) for value in (old, new)), change])
    return lines


def _signed(value: float, digits: int) -> str:
    text = f"{value:+.{digits}f}"
    return text if float(text) else f"{0:.{digits}f}"


def _with_unit(value: float | None, unit: str, digits: int) -> str:
    return "not measured" if value is None else f"{value:.{digits}f} {unit}".strip()


def describe_changes(before: Measures, after: Measures) -> str:
    """Describe the changes of measures in a sentence."""
    parts = []
    for field, (less, more, least) in _WORDS.items():
        old, new = getattr(before, field), getattr(after, field)
        if old is None or new is None or abs(new - old) < least:
            continue
        parts.append((more if new > old else less).format(f"{abs(new - old):.0f}"))
    if before.volume_m3 and after.volume_m3:
        share = after.volume_m3 / before.volume_m3 - 1.0
        if abs(share) >= 0.01:
            parts.append(f"{abs(share):.0%} {'more' if share > 0 else 'less'} volume")
    if after.pieces != before.pieces:
        parts.append(f"{after.pieces} pieces instead of {before.pieces}")
    return f"{', '.join(parts)}." if parts else "No measure changes by 1 cm, 1° or 1 % of the volume."
