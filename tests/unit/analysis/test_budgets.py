"""The AUC against the budget of naturalness: the searches in the comparison, and the text about them."""

from __future__ import annotations

import dataclasses
import json
import math

import pytest
from analysed import blocks_html, variant

from shift3d.analysis.html.blocks import Plot
from shift3d.analysis.html.figure import bars
from shift3d.analysis.html.sections.budgets import budgets
from shift3d.analysis.mlflow.sweep_groups import budget_points
from shift3d.analysis.statistics.intervals import Interval
from shift3d.analysis.tables.budgets import ANY_SHAPE, budget_curves, budget_table
from shift3d.analysis.variants import Variant
from shift3d.task.spec import AttackSpec, split_label

BASE = [0.8, 0.9, 0.7, 0.85]


def searched(search: str, share: float, drawn: float = 0.9, mode: str = "shape") -> Variant:
    """Return a search that leaves a share of every baseline score; the random draws leave another share."""
    scores = {("baseline", "suv"): BASE, ("adversarial", "suv"): [share * one for one in BASE]}
    scores |= {("random_budget", "suv"): [drawn * one for one in BASE]}
    cm = {f"suv-{scene}": 1.0 + scene for scene in range(4)}
    natural = {f"suv-{scene}": scene < 3 for scene in range(4)}
    return dataclasses.replace(variant(scores, mode, surface_distance_cm=cm, natural=natural), search=search)


TRIED = [
    searched("expectation_pca10_within95", 0.6),
    searched("expectation_pca10_within50", 0.8),
    searched("expectation_pca10", 0.5),
    searched("descent", 0.4),
    searched("descent_within95", 0.7, mode="pose"),
]


@pytest.mark.parametrize("budget", [0.0, 50.0, 97.5])
@pytest.mark.parametrize("more", [{}, {"space": "pca", "search_scenes": 3}, {"edit": "chassis.height_m:-1"}])
def test_a_label_says_its_budget(budget: float, more: dict[str, object]) -> None:
    spec = AttackSpec(naturalness=budget, **more)  # type: ignore[arg-type]
    without = AttackSpec(**more)  # type: ignore[arg-type]
    assert split_label(spec.label) == (without.label, budget or None)


def test_searches_under_several_budgets_are_curves() -> None:
    (curve,) = budget_curves(TRIED)
    assert list(curve.variants) == [50.0, 95.0, ANY_SHAPE] and "pca10" in curve.title and "within" not in curve.title
    ratios = [curve.ratio(budget, "adversarial") for budget in curve.variants]
    assert [ratio.mean for ratio in ratios if ratio] == pytest.approx([0.8, 0.6, 0.5])
    drawn = curve.ratio(95.0, "random_budget")
    assert drawn is not None and drawn.mean == pytest.approx(0.9) and curve.ratio(95.0, "edited") is None


def test_the_table_compares_with_random_draws_of_the_same_tasks() -> None:
    line = str(budget_table(TRIED)).splitlines()[4]
    assert "95" in line and "3 of 4" in line and " 2.5 " in line
    assert "0.90 [0.90, 0.90]" in line and "0.60 [0.60, 0.60]" in line
    assert f"{-0.3 * sum(BASE) / 4:.3f}" in line  # 0.3 of the baseline lower than the draws
    assert budget_table(TRIED[3:]) is None and budget_table([]) is None


def test_the_page_orders_budgets_though_a_search_lacks_one() -> None:
    """Under a budget that its vehicles exceed unchanged, a search has no scores."""
    other = [searched("expectation_pca3", 0.5), searched("expectation_pca3_within95", 0.6)]
    _, plot, _ = budgets([*other, *TRIED])
    assert isinstance(plot, Plot)
    assert json.loads(plot.data)["layout"]["xaxis"]["categoryarray"] == ["50", "95", "any shape"]


def test_other_settings_are_other_curves() -> None:
    others = [dataclasses.replace(one, scored_by="sst") for one in TRIED]
    titles = [curve.title for curve in budget_curves([*TRIED, *others])]
    assert len(set(titles)) == 2 and all(("sst" in title) != ("pointpillars" in title) for title in titles)


def test_the_page_draws_both_methods_at_every_budget() -> None:
    page = blocks_html(budgets(TRIED))
    assert page.count("best of random draws") >= 1 and "any shape" in page
    alone = [dataclasses.replace(one, rows=one.rows[one.rows["place"] == "street/0"]) for one in TRIED]
    assert budgets(alone), "a single scene has no interval, and is drawn"
    assert budgets(TRIED[3:]) == []


def test_an_interval_without_an_end_hides_its_own_bar_alone() -> None:
    """The ratio of one budget has no upper end if many draws hold only baselines of score 0."""
    found = bars([Interval(0.5, 0.4, 0.75), Interval(0.5, 0.25, math.inf), Interval(0.5, -math.inf, math.inf)])
    assert found["array"].tolist() == [0.25, 0.0, 0.0]
    assert found["arrayminus"].tolist() == pytest.approx([0.1, 0.25, 0.0])


def test_mlflow_has_a_curve_over_the_budget() -> None:
    import pandas as pd

    settings = ("mode", "alpha", "detector", "scored_by", "accuracy", "search", "effects")
    table = pd.concat(
        [one.auc.assign(selected=True, **{name: getattr(one, name) for name in settings}) for one in TRIED]
    )
    points = {(name.split("/")[1], step): value for name, value, step in budget_points(table)}
    assert points["adversarial", 95] == pytest.approx(0.6) and points["adversarial", 101] == pytest.approx(0.5)
    assert points["random_budget", 50] == pytest.approx(0.9) and len(points) == 6
