"""Pages beside a sweep's report: accuracy against time, effects, and stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from shift3d.analysis.figures.picture import png
from shift3d.analysis.figures.work_precision import work_precision_figure
from shift3d.analysis.html.blocks import Block, Paragraph, Picture, Section, Terms
from shift3d.analysis.html.document import document
from shift3d.analysis.html.sections.effects import impact_blocks
from shift3d.analysis.html.sections.stability import stability_blocks
from shift3d.analysis.tables.accuracy.advice import advice
from shift3d.analysis.tables.accuracy.cost import diagnostics
from shift3d.analysis.tables.accuracy.frontier import RULE, frontier_lines, meanings, measured_headers, settings_tables
from shift3d.analysis.tables.effects import EffectImpact
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic
from shift3d.store.frontier_table import machine_of, read_frontier
from shift3d.store.location import Location
from shift3d.store.resolve import LocationLike, as_location


def frontier_html(frame: pd.DataFrame, machine: Mapping[str, Any]) -> str:
    """Render diagrams, advice and table of each scene set, and the meanings of the columns.

    Args:
        frame: the frontier's table.
        machine: properties of the machine that measured it, by name.
    """
    measured = ", ".join(f"{name} {value}" for name, value in machine.items()) or "not recorded"
    headers = measured_headers(frame)
    sections: list[Section] = []
    for (scenes, table), text in zip(settings_tables(frame, headers), advice(frame).split("\n\n")):
        diagram = png(work_precision_figure(frame, scenes))
        picture = Picture(diagram, f"Rendering time against error, {scenes} scenes")
        sections.append(Section(f"scenes-{len(sections)}", scenes, [Paragraph(text), picture, table]))
    explained: list[Block] = [Paragraph(RULE), Terms(meanings(headers))]
    sections.append(Section("meaning", "What the numbers mean", explained))
    return document("What accuracy costs in time", sections, f"Measured on: {measured}.")


def write_frontier_report(folder: Path) -> str:
    """Write report.html, frontier.png and advice.txt beside folder/frontier.parquet, each atomically.

    The same table gives the same bytes. The report can be rewritten from the table alone.

    Returns: Text to print: the table, the meanings of its columns, and the advice.

    Raises: InputError: the frontier is missing or has another schema version; the disk is full or not writable.
    """
    table = read_frontier(folder / "frontier.parquet")
    if not table.num_rows:
        raise InputError("contains no setting", str(folder / "frontier.parquet"), "Run shift3d frontier again")
    frame = table.to_pandas()
    text = advice(frame)
    write_atomic(folder / "advice.txt", f"{text}\n".encode())
    write_atomic(folder / "frontier.png", png(work_precision_figure(frame)))
    write_atomic(folder / "report.html", frontier_html(frame, machine_of(table)).encode())
    return f"{frontier_lines(frame)}\n\n{text}"


def write_effects_page(path: LocationLike, sweep: str, impacts: Sequence[EffectImpact]) -> Location:
    """Write the page of the effects' impact atomically. Returns its path."""
    section = Section("effects", "Impact and time", impact_blocks(impacts))
    return _written(path, f"Measured impact of effects: {sweep}", [section])


def write_stability_page(path: LocationLike, sweep: str, scores: pd.DataFrame, verification: pd.DataFrame) -> Location:
    """Write the page of one sweep's stability, with every unstable solution; the same tables give the same bytes.

    Raises: InputError: the disk is full or not writable.
    """
    blocks = stability_blocks(verification, shown=None)
    return _written(
        path, f"Stability of {sweep}", [Section("stability", "Solutions scored again", blocks)], diagnostics(scores)
    )


def _written(path: LocationLike, title: str, sections: Sequence[Section], lead: str = "") -> Location:
    location = as_location(path)
    location.write_atomic(document(title, sections, lead).encode())
    return location
