"""HTML page of a fine-tuning: gains, threshold-recall curves of the models, and the paper's figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from shift3d.analysis.html.blocks import Block, Collapsible, Panels, Paragraph, Plot, Section, Terms
from shift3d.analysis.html.document import document
from shift3d.analysis.html.figure import plotly_library
from shift3d.analysis.html.sections.curves import RecallCurve, recall_plot
from shift3d.analysis.tables.table import Cell, Table, number
from shift3d.finetuning.table import ADAPTIVE, TUNED, VANILLA
from shift3d.wording import counted

OBJECTS = {"baseline": "unchanged", "adversarial": "found against vanilla", ADAPTIVE: "found against the model itself"}
SCENE_SETS = {
    "held_out": "same vehicles, held-out streets",
    "other_vehicles": "other body types, held-out streets",
    "natural": "natural streets",
}
MODELS = {VANILLA: "vanilla", TUNED: "fine-tuned", "control": "control"}
COLOURS = {VANILLA: "#7d7d7d", TUNED: "#d55e00", "control": "#2f8fc9"}
PAPER = {"baseline": (0.751, 0.774), "adversarial": (0.482, 0.514)}
"""AUC before and after. Source: SHIFT3D, table tab:fine_tune_auc."""
PAPER_NATURAL = {"APH BEV": (0.810, 0.812), "AP BEV": (0.823, 0.826), "APH 3D": (0.603, 0.605), "AP 3D": (0.610, 0.612)}
"""LEVEL_1 metrics before and after, on the Waymo Open Dataset. Source: SHIFT3D, table tab:natural_metrics."""
_MEANINGS = {
    "vanilla": "the detector before fine-tuning",
    "fine-tuned": "the detector after one epoch on the adversarial objects; mean over its seeds",
    "control": "the detector after the same epoch on the unchanged vehicles of the same tasks",
    "gain": "difference to vanilla on the same objects or scenes; [95 %, scenes resampled]",
    "objects unchanged": "vehicles as placed, before a search",
    "objects found against": "adversarial objects of a search against this detector",
}


def gains_table(table: pd.DataFrame) -> Table:
    """Make the table of AUC and AP: vanilla, each tuned model's mean over its seeds, gains, and the paper's figures.

    table: of schema `finetuning.table.FINETUNE`.
    """
    lines: list[Sequence[Cell]] = []
    kinds: list[str] = []
    means = table[table["seed"].isna()]
    for (scene_set, objects, metric), own in means.groupby(
        ["scene_set", "objects", "metric"], sort=False, dropna=False
    ):
        before = own[own["model"] == VANILLA]["value"]
        for row in own[own["model"] != VANILLA].itertuples():
            lines.append(
                [
                    SCENE_SETS[scene_set],
                    _what(objects, metric),
                    MODELS[row.model],
                    number(before.iloc[0] if len(before) else None),
                    (number(row.value), _between(row.low, row.high)),
                    (_signed(row.gain), _between(row.gain_low, row.gain_high)),
                ]
            )
            kinds.append("ours")
        paper = PAPER.get(str(objects)) if metric == "auc" else PAPER_NATURAL.get(metric)
        if paper and scene_set in ("held_out", "natural"):
            texts = [number(paper[0]), number(paper[1]), _signed(paper[1] - paper[0])]
            lines.append([SCENE_SETS[scene_set], _what(objects, metric), "paper", *texts])
            kinds.append("paper")
    return Table("Before and after", ["scenes", "metric", "model", "vanilla", "after", "gain"], lines, kinds)


def seeds_table(table: pd.DataFrame) -> Table:
    """Make the table of every seed's numbers."""
    lines = [
        [
            SCENE_SETS[row.scene_set],
            _what(row.objects, row.metric),
            MODELS[row.model],
            f"{row.seed:.0f}",
            number(row.value),
            _signed(row.gain),
            str(row.number),
        ]
        for row in table[table["seed"].notna()].itertuples()
    ]
    return Table("Every seed", ["scenes", "metric", "model", "seed", "after", "gain", "number"], lines)


def finetune_page(
    table: pd.DataFrame, scores: pd.DataFrame, provenance: Mapping[str, Any], commands: Sequence[str]
) -> str:
    """Return the page as HTML; the same content gives the same text.

    table: of schema `FINETUNE`. scores: one row per object, as for `finetune_table`. provenance: of one of the tuned
    weights. commands: commands that made the results, in order.
    """
    lead = (
        "shift3d attacks a detector on training streets, fine-tunes it for one epoch on the adversarial objects, and "
        "measures it on streets that neither training nor fine-tuning saw."
    )
    short: list[Block] = [gains_table(table), Terms(_MEANINGS), Collapsible("Every seed", [seeds_table(table)])]
    made: list[Block] = [Terms(_facts(provenance)), *(Paragraph(command) for command in commands)]
    curves = [
        _panel(f"curve-{index}", str(scene_set), str(objects), own)
        for index, ((scene_set, objects), own) in enumerate(scores.groupby(["scene_set", "objects"], sort=False))
    ]
    sections = [
        Section("gains", "Before and after", short),
        Section("curves", "Threshold-recall curves", [Panels(curves)]),
        Section("made", "Provenance and commands", made),
    ]
    return document("Fine-tuning on adversarial objects", sections, lead, plotly_library())


def _panel(key: str, scene_set: str, objects: str, rows: pd.DataFrame) -> Plot:
    found = [
        RecallCurve(MODELS[model], own["score"], own["place"], COLOURS[model], width=3 if model == TUNED else 2)
        for model, own in rows.groupby("model", sort=False)
    ]
    about = f"{SCENE_SETS[scene_set]}, objects {OBJECTS[objects]}"
    caption = f"{about}: {counted(rows['place'].nunique(), 'scene')}; seeds pooled"
    return recall_plot(key, found, f"Threshold-recall curves, {about}", caption)


def _what(objects: Any, metric: str) -> str:
    return f"AUC, objects {OBJECTS[objects]}" if metric == "auc" else f"{metric}, LEVEL_1"


def _signed(value: Any) -> str:
    return "-" if pd.isna(value) else f"{value:+.3f}"


def _between(low: Any, high: Any) -> str:
    return "no interval" if pd.isna(low) or pd.isna(high) else f"[{low:.3f}, {high:.3f}]"


def _facts(provenance: Mapping[str, Any]) -> dict[str, str]:
    source = provenance["finetuned_on"]
    vehicles = ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in source["vehicles"].items())
    left_out = ", ".join(f"{count} {why.replace('_', ' ')}" for why, count in source["left_out"].items()) or "none"
    return {
        "objects": f"{source['objects']} of {counted(len(source['scenes']), 'scene')}: {vehicles}",
        "left out": left_out,
        "sweep": f"{source['sweep']} {source['spec_hash']}",
        "started from": f"{provenance['started_from']['file']}, BLAKE2b {provenance['started_from']['blake2b']}",
        "rate": f"peak {provenance['rate']:g}, {counted(provenance['steps'], 'step')}",
    }
