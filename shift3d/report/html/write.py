"""The report: its sections in order, as one file."""

from __future__ import annotations

from shift3d.report.html.accuracy import accuracy
from shift3d.report.html.areas import areas, in_short
from shift3d.report.html.bev import bev, transfer_grid
from shift3d.report.html.cases import hard_cases
from shift3d.report.html.choices import choices
from shift3d.report.html.coverage import coverage_section
from shift3d.report.html.curves import curves
from shift3d.report.html.differences import differences
from shift3d.report.html.document import document
from shift3d.report.html.effects import effects
from shift3d.report.html.figure import plotly_library
from shift3d.report.html.overview import overview
from shift3d.report.html.paths import paths
from shift3d.report.html.stability import stability
from shift3d.report.html.sweep import Sweep, read_sweep, variants
from shift3d.report.placement import nothing_placed
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location
from shift3d.wording import counted

__all__ = ["report_page", "write_report"]


def report_page(sweep: Sweep, cases: int = 4) -> str:
    """The page of a sweep; the same sweep to the same text. cases: hard cases to show, fewer where fewer fell."""
    found = variants(sweep)
    sections = [
        in_short(found, nothing_placed(sweep.scores, sweep.plan.settings)),
        overview(sweep),
        areas(found),
        differences(found),
        curves(found),
        bev(sweep, found),
        transfer_grid(sweep, found),
        paths(sweep, found),
        choices(sweep),
        hard_cases(sweep, cases),
        accuracy(sweep),
        effects(sweep),
        stability(sweep),
        coverage_section(sweep),
    ]
    lead = (
        f"{counted(len(sweep.plan.tasks), 'attack')} on a LiDAR vehicle detector: a vehicle is inserted into a scene, "
        "and its shape or pose is changed, by the detector's gradient, until the detector misses it."
    )
    return document(f"shift3d: {sweep.plan.sweep}", lead, sections, plotly_library())


def write_report(folder: LocationLike, cases: int = 4) -> Location:
    """Write ``report.html`` into a finished sweep's folder, whole or not at all; returns its path.

    Raises:
        InputError: the folder is no finished sweep's, a table in it is damaged, or the disk is full.
    """
    path = as_location(folder) / "report.html"
    path.write_atomic(report_page(read_sweep(folder), cases).encode())
    return path
