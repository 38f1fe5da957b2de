"""Handmade rows of a frontier, whose right answers can be worked out on paper."""

from __future__ import annotations

from typing import Any

import pandas as pd

from shift3d.accuracy_time.pareto import pareto_flags

PAPER_MS = 800.0


def frontier_row(setting: str, ms: float, **changes: Any) -> dict[str, Any]:
    """Make a row without any error; `paper` takes 800 ms."""
    row: dict[str, Any] = {"setting": setting, "method": "presets", "knob": None, "knob_name": None, "preset": None}
    row |= {"start": "warm" if "warm" in setting else "cold", "grid": False, "gradient": "no"}
    row |= {"scenes": "street", "renders": 10, "beams": 20_000, "hits": 10_000, "ms_median": ms, "ms_low": 0.9 * ms}
    row |= {"ms_high": 1.2 * ms, "ratio_to_paper": PAPER_MS / ms, "ratio_to_paper_chord": PAPER_MS / 4 / ms}
    row |= {"evaluations_per_beam": 5.0}
    row |= dict.fromkeys(("missed_hits", "missed_hits_2cm", "wrong_surface", "false_hits"), 0.0)
    row |= dict.fromkeys(("depth_p50_m", "depth_p99_m", "depth_max_m", "residual_max_m"), 0.0)
    row |= dict.fromkeys(("gradient_cosine", "gradient_norm_ratio", "score_delta", "auc_delta"))
    row |= dict.fromkeys(("detector_ms_median", "step_ms_median", "step_ratio_to_paper"))
    return {**row, "attack_score": None, "unresolved_beams": 0, "pareto": True, **changes}


def with_depth(p99_m: float) -> dict[str, float]:
    """Return depth columns that give an effective error of p99_m: (0.5 * 0.1 + 0.49 + 0.01 * 46) p99_m."""
    return {"depth_p50_m": 0.1 * p99_m, "depth_p99_m": p99_m, "depth_max_m": 46.0 * p99_m}


def march(knob: float, ms: float, p99_m: float, **more: Any) -> dict[str, Any]:
    named = {"method": "march", "knob": knob, "knob_name": "step_m"}
    return frontier_row(f"march {knob:g} m", ms, **named, **with_depth(p99_m), **more)


def small_rows() -> list[dict[str, Any]]:
    """Return six cold settings and a warm one. Front: draft, standard, reference, and the warm one."""
    found = {"gradient_cosine": 0.9995, "auc_delta": -0.002, "step_ms_median": 25.0, "step_ratio_to_paper": 320.0}
    return [
        march(0.4, 100.0, 2e-2),
        march(0.2, 200.0, 1e-2),
        march(0.1, 400.0, 5e-3),
        frontier_row("paper", 800.0, preset="paper", missed_hits=0.003, wrong_surface=0.002, **with_depth(1e-3)),
        frontier_row("draft", 1.0, preset="draft", missed_hits=0.001, **with_depth(1e-3)),
        frontier_row("standard", 2.0, preset="standard", **with_depth(1e-5), **found),
        frontier_row("standard, warm", 0.5, method="warm", **with_depth(1e-5)),
        frontier_row("reference", 5000.0, preset="reference"),
    ]


def flagged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with the column `pareto` that follows from them."""
    return [row | {"pareto": flag} for row, flag in zip(rows, pareto_flags(rows))]


def frame_of(rows: list[dict[str, Any]]) -> pd.DataFrame:
    """Return the rows as the frame that reading them back from Parquet gives."""
    from shift3d.store.frontier_table import frontier_table

    return frontier_table(flagged(rows)).to_pandas()


def _swept(method: str, knob_name: str, rows: list[tuple[float, float, float, float]], **more: Any) -> list[Any]:
    """Return rows of one method from (knob, ms, missed, p99_m)."""
    return [
        frontier_row(
            f"{method} {knob:g}",
            ms,
            method=method,
            knob=knob,
            knob_name=knob_name,
            missed_hits=missed,
            missed_hits_2cm=missed / 10,
            wrong_surface=0.6 * missed,
            **with_depth(p99),
            **more,
        )
        for knob, ms, missed, p99 in rows
    ]


def realistic_rows(scenes: str = "street", slower: float = 1.0) -> list[dict[str, Any]]:
    """Return 31 settings like those of a real measurement, with times and errors of their order of magnitude."""
    steps, missed = (0.4, 0.2, 0.1, 0.05, 0.025, 0.0125), (0.019, 0.0077, 0.0034, 0.0015, 2e-4, 5e-5)
    marches = [(step, 80 / step, share, 2e-7) for step, share in zip(steps, missed)]
    boxed = [(step, 1.9 + 0.6 / step, share, 2e-7) for step, share in zip(steps, missed)]
    rows = _swept("march, whole beam", "step_m", marches)
    rows += _swept("march in the box", "step_m", boxed)
    bisections = [(4, 5.1, 0.0034, 6e-3), (8, 5.9, 0.0034, 4e-4), (12, 6.8, 0.0034, 2.4e-5), (16, 7.7, 0.0034, 1.5e-6)]
    rows += _swept("bisection", "iterations", bisections)
    traced = [(20, 0.9, 0.08, 3e-3), (50, 1.4, 0.03, 4e-4), (200, 3.1, 0.011, 4e-5)]
    rows += _swept("sphere tracing", "iterations", traced)
    traced_and_covered = [
        (1e-3, 1.5, 1e-4, 9e-4),
        (1e-4, 1.8, 1e-4, 9e-5),
        (1e-5, 2.2, 5e-5, 8e-6),
        (1e-6, 2.5, 5e-5, 8e-7),
    ]
    rows += _swept("tolerance", "tolerance_m", traced_and_covered)
    for name, ms, p99 in (("float64", 4.6, 7e-6), ("float32", 2.2, 8e-6), ("bfloat16", 40.0, 2e-3)):
        rows.append(frontier_row(name, ms, method="precision", missed_hits=5e-5, **with_depth(p99)))
    rows.append(frontier_row("standard, warm", 0.62, method="warm start", missed_hits=5e-5, **with_depth(8e-6)))
    rows.append(frontier_row("draft, warm", 0.31, method="warm start", missed_hits=2e-3, **with_depth(9e-4)))
    presets = (("draft", 0.8, 2e-3, 9e-4), ("standard", 1.9, 3e-5, 8e-6), ("paper", 800.0, 0.0034, 2e-7))
    for name, ms, share, p99 in presets:
        rows.append(frontier_row(name, ms, preset=name, missed_hits=share, wrong_surface=share / 2, **with_depth(p99)))
    rows.append(frontier_row("reference", 5200.0, preset="reference", gradient_cosine=1.0, score_delta=0.0))
    for row in rows:
        for name in ("ms_median", "ms_low", "ms_high"):
            row[name] *= slower
        row["scenes"] = scenes
        row["evaluations_per_beam"] = 3.0 * row["ms_median"] ** 0.8
        if row["preset"] is not None:
            row |= {"gradient_cosine": 0.99995, "gradient_norm_ratio": 1.001, "score_delta": 0.002, "auc_delta": -0.001}
            row |= {"detector_ms_median": 21.0, "step_ms_median": 40.0, "step_ratio_to_paper": 70.0}
    return rows
