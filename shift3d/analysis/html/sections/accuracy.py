"""What the sweep's accuracy was, what it cost, and what other presets would."""

from __future__ import annotations

import math
from typing import Any

from shift3d.analysis.html.document import Section, paragraph, table
from shift3d.analysis.results import Sweep
from shift3d.analysis.tables.accuracy_cost import accuracy_cost, measured_presets
from shift3d.analysis.tables.numbers import factor, length, milliseconds, share
from shift3d.analysis.tables.numerics import diagnostics

__all__ = ["accuracy"]

_HEADER = ["preset", "a rendering", "times as fast as paper", "hits lost or wrong", "depth p99", "depth max",
           "gradient cosine", "an attack step", "change of AUC"]  # fmt: skip


def accuracy(sweep: Sweep) -> Section:
    """The section: the audit of this sweep's own objects, and the presets as a frontier measured them."""
    presets, whose = measured_presets()
    told = accuracy_cost(sweep.scores, sweep.timings, presets, whose).splitlines()[1:]
    body = [paragraph(line.strip()) for line in told]
    used = set(sweep.scores["accuracy"])
    lines = [_line(str(name), row) for name, row in presets.iterrows()]
    kinds = ["ours" if name in used else "" for name in presets.index]
    body.append(table(f"Accuracy against time, by {whose}", _HEADER, lines, kinds))
    body.append(paragraph(diagnostics(sweep.scores)))
    return Section("accuracy", "Accuracy against time", body)


def _line(name: str, row: Any) -> list[str]:
    lost = sum(float(row[error]) for error in ("missed_hits", "wrong_surface", "false_hits"))
    step = float(row["step_ms_median"]) if row["step_ms_median"] is not None else math.nan
    return [
        name,
        milliseconds(float(row["ms_median"])),
        factor(float(row["ratio_to_paper"])),
        share(lost),
        length(float(row["depth_p99_m"])),
        length(float(row["depth_max_m"])),
        f"{float(row['gradient_cosine']):.3g}",
        milliseconds(step) if math.isfinite(step) else "-",
        f"{float(row['auc_delta']):.1e}",
    ]
