"""Selection of the solutions of a finished sweep that a suite freezes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from shift3d.errors import InputError
from shift3d.seeding import generator
from shift3d.store.location import Location
from shift3d.store.tables import read_final

if TYPE_CHECKING:
    import pandas as pd

_KEY = ["task_id", "method", "replicate"]


@dataclass(frozen=True)
class SelectionRule:
    """Rule of the selection.

    method: of the solutions. count: largest number of hard objects. by: "random" draws without bias; "hardest" takes
    the lowest scores, which are in part low by chance and rise under any other weights. controls: also freeze the
    unchanged vehicle of each task.
    """

    method: str = "adversarial"
    count: int = 500
    by: Literal["random", "hardest"] = "random"
    seed: int = 0
    controls: bool = True


@dataclass(frozen=True)
class Selection:
    """Selected rows of ``solutions.parquet``, and rows of ``scores.parquet``.

    hard, controls: solutions in plan order. scores: all rows of the sweep with a score, one per object and detector.
    left_out: number of ineligible solutions by reason. unverified: number of hard ones without verification.
    """

    hard: pd.DataFrame
    controls: pd.DataFrame
    scores: pd.DataFrame
    left_out: dict[str, int]
    unverified: int


def select_solutions(sweep: Location, choice: SelectionRule) -> Selection:
    """Select the solutions of a finished sweep to freeze; the same tables and choice give the same solutions.

    Left out: objects without a score, without a change by the search, or with a broken constraint; objects that a
    verification found unstable; shapes of a search or a draw that were measured as not natural.

    Raises: InputError: the sweep is not finished, has no such method, or has no eligible solution.
    """
    scores, solutions = (read_final(sweep, name).to_pandas() for name in ("scores", "solutions"))
    where = str(sweep / "final" / "scores.parquet")
    rows = scores[scores["method"] == choice.method]
    if rows.empty:
        methods = ", ".join(sorted(scores["method"].unique()))
        raise InputError(f"has no method {choice.method!r}", where, f"Choose one of: {methods}")
    own = rows[rows["scored_by"] == rows["detector"]]
    eligible, left_out = _eligible(own)
    if eligible.empty:
        why = ", ".join(f"{number} {reason}" for reason, number in left_out.items())
        raise InputError(f"no {choice.method} object can be frozen: {why}", where)
    taken = _taken(eligible, choice)
    hard = solutions.merge(taken[_KEY], on=_KEY)
    controls = solutions[(solutions["method"] == "baseline") & solutions["task_id"].isin(hard["task_id"])]
    controls = controls if choice.controls and choice.method != "baseline" else controls[:0]
    return Selection(hard, controls, scores[scores["score"].notna()], left_out, int(taken["stable"].isna().sum()))


def _eligible(rows: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, int]]:
    """Return the rows that may be frozen, and the number of other rows by reason."""
    left_out: dict[str, int] = {}
    for reason, keeps in (
        ("without a score", rows["score"].notna()),
        ("whose search found no valid step", rows["status"].ne("no_valid_step") | rows["score"].isna()),
        ("unchanged by the search", rows["best_step"].ne(0) | (rows["method"] == "baseline")),
        ("overlapping other points", rows["overlap_ok"].ne(False)),  # null passes
        ("without contact to the scene", rows["contact_ok"].ne(False)),
        ("unstable", rows["stable"].ne(False)),
        # The vehicle's original shape passes, however far it is from the reference set.
        ("unnatural", rows["natural"].ne(False) | (rows["mode"] == "pose") | (rows["method"] == "baseline")),
    ):
        keeps = keeps[rows.index]
        if (~keeps).any():
            left_out[reason] = int((~keeps).sum())
        rows = rows[keeps]
    return rows, left_out


def _taken(rows: pd.DataFrame, choice: SelectionRule) -> pd.DataFrame:
    if len(rows) <= choice.count:
        return rows
    if choice.by == "hardest":
        return rows.sort_values(["score", *_KEY], kind="stable").iloc[: choice.count].sort_index()
    order = generator("suite", choice.seed, len(rows)).permutation(len(rows))[: choice.count]
    return rows.iloc[sorted(order)]
