"""The hard cases: what fooled the detector most, seen from all sides, measured, and how to take it away."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from shift3d.analysis.cases.hardest import Case, Seen, hardest, see
from shift3d.analysis.cases.measures import DEFINITIONS, change_lines, in_words, measure_mesh
from shift3d.analysis.html.document import Markup, Section, escape, paragraph, table, terms
from shift3d.analysis.html.sections.case_figures import from_above, turnable
from shift3d.analysis.html.sections.paths import case_path
from shift3d.analysis.results import Sweep
from shift3d.errors import InputError
from shift3d.geometry.se3 import wrap_angle
from shift3d.wording import counted

if TYPE_CHECKING:
    import trimesh

    from shift3d.task.assets import Assets

__all__ = ["hard_cases"]

_TITLE = "The hard cases"
_HEADER = ["measure", "baseline", "adversarial", "change"]


def hard_cases(sweep: Sweep, count: int = 4) -> Section:
    """The section: the most harmful solutions rendered again. What cannot be loaded is said, not raised."""
    scored = sweep.scored
    # Not `~`: what was not looked at is None.
    broken = set(scored.loc[(scored["mode"] == "shape") & (scored["still_a_car"] == False), "task_id"])  # noqa: E712
    chosen = hardest(sweep.scores, count, broken)
    if not chosen:
        nothing = "No score fell below its baseline's: there is no hard case to show."
        return Section("cases", _TITLE, [paragraph(nothing, "missing")])
    made = _Made()
    parts = []
    for number, case in enumerate(chosen, start=1):
        try:
            parts += _case(sweep, case, number, made)
        except InputError as error:
            parts.append(paragraph(f"Case {number}, task {case.task_id}, cannot be drawn: {error.what}", "missing"))
    lead = (
        f"The {len(chosen)} solutions whose score fell furthest below the baseline's of the same task, other vehicles "
        f"and scenes first.{_about(broken, chosen)} Each is rendered again here as the sweep rendered it. Drag a "
        "vehicle to turn both."
    )
    return Section("cases", _TITLE, [paragraph(lead), *parts, _definitions()])


def _about(broken: set[str], chosen: list[Case]) -> str:
    """What became of the shapes that are no cars any more."""
    shown = sum(case.task_id in broken for case in chosen)
    if not broken:
        return ""
    if not shown:
        return f" Shapes that are no longer cars ({counted(len(broken), 'task')}) are left out: they are easy to miss."
    return f" The last {shown} are no longer cars: there were not enough others."


def _definitions() -> str:
    return f"<h3>How it is measured</h3>{terms(DEFINITIONS)}"


@dataclass
class _Made:
    """What cases share. assets: by their place in the plan. meshes: by vehicle and code."""

    assets: dict[int, Assets] = field(default_factory=dict)
    meshes: dict[tuple[str, bytes], trimesh.Trimesh] = field(default_factory=dict)


def _case(sweep: Sweep, case: Case, number: int, made: _Made) -> list[str]:
    from shift3d.task.assets import load_assets

    (task,) = sweep.plan.tasks.starting_with(case.task_id)
    if task.assets not in made.assets:
        made.assets[task.assets] = load_assets(sweep.plan.assets[task.assets])
    rows = sweep.solutions[(sweep.solutions["task_id"] == case.task_id) & (sweep.solutions["replicate"] == 0)]
    both = [rows[rows["method"] == method].iloc[0].to_dict() for method in ("baseline", "adversarial")]
    centre = np.mean([[row["x_m"], row["y_m"]] for row in both], axis=0)
    before, after = (see(task.spec, made.assets[task.assets], row, centre, made.meshes) for row in both)
    key = f"case-{number}"
    return [
        f'<article aria-labelledby="{key}"><h3 id="{key}">{number}. {escape(_headline(case))}</h3>',
        paragraph(_said(case, task.spec, before, after)),
        turnable(key, case, before, after),
        *_changes(case, number, before, after),
        from_above(key, case, before, after, centre),
        case_path(key, sweep.trajectories[sweep.trajectories["task_id"] == case.task_id]),
        paragraph(_again(case, before, after)),
        paragraph(Markup(f"Take it away (OUT is this page's folder): <code>{_command(case, number)}</code>")),
        "</article>",
    ]


def _headline(case: Case) -> str:
    return f"{case.vehicle.replace('_', ' ')}, {case.mode}: score {case.before:.2f} → {case.after:.2f}"


def _command(case: Case, number: int) -> str:
    return escape(f"shift3d export OUT task={case.task_id} method=adversarial to=hard_case_{number}")


def _said(case: Case, spec: Any, before: Seen, after: Seen) -> str:
    parts = [f"Scene {case.scene}, attacked {spec.detector}"]
    if spec.lambda_ is not None:
        parts.append(f"lambda {spec.lambda_:g}")
    parts.append(f"effects {', '.join(spec.effects)}" if spec.effects else "no effects")
    changed = in_words(measure_mesh(before.mesh), measure_mesh(after.mesh)) if case.mode == "shape" else _moved(
        before, after
    )  # fmt: skip
    return f"{', '.join(parts)}. What changed: {changed}"


def _moved(before: Seen, after: Seen) -> str:
    """The change of pose in words, in the vehicle's own axes."""
    shift, yaw = after.theta[:2] - before.theta[:2], before.theta[3]
    forward = 100.0 * float(shift @ [math.cos(yaw), math.sin(yaw)])
    left = 100.0 * float(shift @ [-math.sin(yaw), math.cos(yaw)])
    turn = math.degrees(wrap_angle(float(after.theta[3] - yaw)))
    pitch, roll = (math.degrees(float(after.theta[i] - before.theta[i])) for i in (4, 5))
    return (
        f"moved {abs(forward):.0f} cm {'forward' if forward >= 0 else 'back'} and {abs(left):.0f} cm to the "
        f"{'left' if left >= 0 else 'right'}, turned {abs(turn):.0f}° to the {'left' if turn >= 0 else 'right'}, nose "
        f"{abs(pitch):.1f}° {'down' if pitch >= 0 else 'up'}, left side {abs(roll):.1f}° "
        f"{'up' if roll >= 0 else 'down'}; its shape is the baseline's."
    )


def _changes(case: Case, number: int, before: Seen, after: Seen) -> list[str]:
    if case.mode != "shape":
        return []
    lines = change_lines(measure_mesh(before.mesh), measure_mesh(after.mesh))
    return [table(f"Case {number}, measured on the meshes", _HEADER, lines)]


def _again(case: Case, before: Seen, after: Seen) -> str:
    """Whether the pictures show the scores that the sweep reported."""
    off = max(abs(before.score - case.before), abs(after.score - case.after))
    if off <= 1e-6:
        return f"Task {case.task_id}. Scored again for this page: the sweep's scores to 1e-6."
    said = f"Scored again for this page: {before.score:.4f} and {after.score:.4f}, off the sweep's by {off:.1e}."
    changed = " The program is not the one that ran the sweep, or the machine rounds otherwise." if off > 1e-3 else ""
    return f"Task {case.task_id}. {said}{changed}"
