"""Sections about common properties of missed objects, and about typical changes by attacks, in cm and degrees."""

from __future__ import annotations

from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Block, Collapsible, Paragraph, Plot, Terms, folded, missing
from shift3d.analysis.html.figure import axis, bars, marks, plot
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.failure_rules import failure_rules, left_out, rule_objects, rules_table
from shift3d.analysis.tables.patterns import Pattern, pattern_groups, patterns_table
from shift3d.errors import InputError
from shift3d.vehicles.mesh_measures import DEFINITIONS

_RULES_LEAD = (
    "Shallow trees found these rules on every other scene and every other vehicle. A rule applies only to objects that "
    "match no rule above it. A difference is the mean score of the matching objects minus that of all others: first on "
    "the objects that the rule was found on, then on new objects. A rule holds if all differences on new objects are "
    "below zero with 95 % confidence. Scenes count as random draws, and so do vehicles that the rule was not found on. "
    "A rule states an association, not a cause."
)


def rules(sweep: Sweep) -> list[Block]:
    """Build the section of failure rules, or a sentence if a sweep has too few scenes or no rule."""
    objects = rule_objects(sweep)
    try:
        found = failure_rules(objects)
    except InputError as error:
        return [missing(f"{error.what[:1].upper()}{error.what[1:]}.")]
    nothing = missing("No measured quantity separates objects with low scores from the other objects.")
    blocks: list[Block] = [Paragraph(_RULES_LEAD), rules_table(found)] if found else [nothing]
    if lacking := left_out(objects):
        blocks.append(Paragraph(f"{lacking}."))
    return blocks


_LEAD = (
    "Measured on the meshes and poses of every baseline and its solution, whatever the solution's score. Change: mean "
    "over all solutions, with a 95 % interval, whole scenes resampled. Less and more: shares of the solutions whose "
    "measure falls or rises by at least 1 cm, 1°, 0.01 m³ or one piece."
)
_UNMEASURED = "The shapes are not measured. Run shift3d patterns OUT to measure them (OUT is this page's folder)."


def patterns(sweep: Sweep) -> list[Block]:
    """Build the section of changes, with a table and figures per search; poses need no separate command."""
    parts: list[tuple[str, list[Block]]] = []
    for number, (label, found) in enumerate(pattern_groups(sweep.patterns, sweep.scores)):
        table = patterns_table(f"Changes: {label}", found)
        parts.append((f"Changes: {label}", [table, *_figures(f"patterns-{number}", label, found)]))
    unmeasured = sweep.patterns.empty and (sweep.solutions["mode"] != "pose").any()
    lacking: list[Block] = [missing(_UNMEASURED)] if unmeasured else []
    if not parts:
        return lacking or [missing("No task has a solution.")]
    meanings = Collapsible("How the meshes are measured", [Terms(DEFINITIONS)])
    return [Paragraph(_LEAD), *lacking, *folded(parts, shown=2), meanings]


def _figures(key: str, label: str, found: list[Pattern]) -> list[Plot]:
    """Plot changes with their intervals, one figure per unit that has several measures."""
    figures = []
    for name, unit in (("centimetres", "cm"), ("degrees", "°")):
        shown = [pattern for pattern in found if pattern.unit == unit]
        if len(shown) < 2:
            continue
        marker, ends = {"size": 9, "color": COLOURS["adversarial"]}, bars([p.change for p in shown])
        trace = marks([p.change.mean for p in shown], [p.name for p in shown], marker, error_x=ends)
        layout = {
            "xaxis": axis(f"change, {unit}", zeroline=True, rangemode="tozero"),
            "yaxis": axis("", autorange="reversed"),
        }
        changes = ", ".join(f"{pattern.name} {pattern.change.mean:+.1f}" for pattern in shown)
        caption = f"Mean change in {name}, {label}"
        figures.append(plot(f"{key}-{name}", [trace], layout, f"{caption}: {changes}", caption, 60 + 34 * len(shown)))
    return figures
