"""Page of a frontier: accuracy against time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from shift3d.analysis.figures.picture import png
from shift3d.analysis.figures.work_precision import work_precision_figure
from shift3d.analysis.html.blocks import Block, Paragraph, Picture, Section, Terms
from shift3d.analysis.html.document import document
from shift3d.analysis.tables.accuracy.advice import advice
from shift3d.analysis.tables.accuracy.frontier import RULE, frontier_lines, meanings, measured_headers, settings_tables
from shift3d.errors import InputError
from shift3d.store.atomic import write_atomic
from shift3d.store.frontier_table import machine_of, read_frontier


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
