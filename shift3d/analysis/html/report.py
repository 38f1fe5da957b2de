"""Report page of a sweep: all sections, most wanted first, in one file."""

from __future__ import annotations

from collections.abc import Callable

from shift3d.analysis.cases.rendered import PageCache
from shift3d.analysis.html.blocks import Block, Section
from shift3d.analysis.html.document import document, write_page
from shift3d.analysis.html.figure import plotly_library
from shift3d.analysis.html.sections.auc import auc, differences, sensors
from shift3d.analysis.html.sections.bev import bev, transfer_grid
from shift3d.analysis.html.sections.budgets import budgets
from shift3d.analysis.html.sections.cases import hard_cases
from shift3d.analysis.html.sections.curves import curves
from shift3d.analysis.html.sections.effects import effects
from shift3d.analysis.html.sections.gallery import gallery
from shift3d.analysis.html.sections.overview import choices, coverage, overview
from shift3d.analysis.html.sections.paths import paths
from shift3d.analysis.html.sections.patterns import patterns, rules
from shift3d.analysis.html.sections.retrieval import retrieval
from shift3d.analysis.html.sections.stability import accuracy, stability
from shift3d.analysis.html.sections.summary import in_short
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.tables.auc import natural_search
from shift3d.analysis.tables.coverage import (
    no_placement_message,
    small_sweep_warning,
    unresponsive_detectors,
    unscored_tasks,
)
from shift3d.analysis.variants import variants
from shift3d.progress_bar import progress_bar
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.sweep.planning.plan_view import merged_lines
from shift3d.wording import counted


def report_page(sweep: Sweep, cases: int = 4) -> str:
    """Render the page of a sweep; the same sweep gives the same text. cases: maximum number of hard cases."""
    plan = sweep.plan
    found, loaded = variants(sweep.auc, sweep.scored), PageCache(plan)
    known = [unscored_tasks(sweep.scores, len(plan.tasks)), small_sweep_warning(plan)]
    known += [unresponsive_detectors(sweep.scores), *merged_lines(plan.tasks)]
    caveat = ". ".join(line for line in known if line)
    further = natural_search(sweep.scores, plan.assets)
    sections: list[tuple[str, str, Callable[[], list[Block]]]] = [
        (
            "short",
            "In short",
            lambda: in_short(found, caveat, no_placement_message(sweep.scores, plan.settings), further),
        ),
        ("cases", "The hard cases", lambda: hard_cases(sweep, loaded, cases)),
        ("gallery", "Gallery", lambda: gallery(sweep, loaded)),
        ("budgets", "Score against the naturalness budget", lambda: budgets(found)),
        ("sensors", "Sensor or detector", lambda: sensors(sweep)),
        ("auc", "Area under the curve", lambda: auc(sweep, found)),
        ("curves", "Threshold-recall curves", lambda: curves(found)),
        ("bev", "Where the score falls", lambda: bev(sweep, found)),
        ("transfer", "Shapes in other scenes", lambda: transfer_grid(sweep, found)),
        ("paths", "Score by search step", lambda: paths(sweep, found)),
        ("patterns", "What attacks change", lambda: patterns(sweep)),
        ("rules", "What the missed objects share", lambda: rules(sweep)),
        ("retrieval", "Natural kin", lambda: retrieval(sweep, loaded)),
        ("differences", "Paired differences", lambda: differences(found)),
        ("choices", "Choice of hyper-parameters", lambda: choices(sweep)),
        ("stability", "Stability", lambda: stability(sweep)),
        ("accuracy", "Accuracy against time", lambda: accuracy(sweep)),
        ("effects", "Effects", lambda: effects(sweep)),
        ("run", "Settings and versions", lambda: overview(sweep)),
        ("coverage", "Failures and coverage", lambda: coverage(sweep)),
    ]
    lead = (
        f"{counted(len(plan.tasks), 'attack')} on a LiDAR vehicle detector. An attack inserts a vehicle into a scene "
        "and searches for a shape or pose with a lower detection score."
    )
    bar = progress_bar(sections, desc="page sections", leave=False)
    shown = [Section(key, title, blocks) for key, title, make in bar if (blocks := make())]
    return document(f"shift3d: {plan.sweep}", shown, lead, plotly_library())


def write_report(folder: LocationLike, cases: int = 4) -> Location:
    """Write ``report.html`` into a finished sweep's folder atomically. Returns its path.

    Raises: InputError: the folder is no finished sweep's, a table in it is damaged, or the disk is full.
    """
    return write_page(as_location(folder) / "report.html", report_page(read_sweep(folder), cases))
