"""The paper's choice of lambda and alpha, and the stated reasons."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest

from shift3d.analysis.tables.choices import choice_tables, papers_choice, reasons
from shift3d.store.tables import table_from_rows
from shift3d.sweep.results.hyperparameters import (
    NEARLY_EQUAL,
    choice_rows,
    choose_alphas,
    choose_lambdas,
    select_lambda,
)


@pytest.mark.parametrize(
    ("losses", "chosen"),
    [
        ({1.0: 0.5, 10.0: 0.9}, 1.0),  # clearly lower
        ({1.0: 0.9, 10.0: 0.5}, 10.0),
        ({1.0: 1.0, 10.0: 1.0 + 0.99 * NEARLY_EQUAL}, 10.0),  # nearly equal: the larger one
        ({1.0: 1.0, 10.0: 1.0 + 1.01 * NEARLY_EQUAL}, 1.0),
        ({1.0: 0.0, 10.0: 0.0}, 10.0),
        ({0.1: 1.0, 1.0: 1.04, 10.0: 2.0}, 1.0),
        ({3.0: 7.0}, 3.0),
    ],
)
def test_lowest_loss_or_the_larger_lambda_when_nearly_equal(losses: dict[float, float], chosen: float) -> None:
    assert select_lambda(losses) == chosen


def test_nothing_to_choose_from() -> None:
    with pytest.raises(ValueError):
        select_lambda({})


def scored(
    alpha: float, weight: float | None, score: float, loss: float, scene: str = "s0", **more: Any
) -> dict[str, Any]:
    row = {"vehicle": "coupe", "mode": "shape", "alpha": alpha, "lambda": weight, "detector": "p", "scored_by": "p"}
    row |= {
        "accuracy": "standard",
        "search": "descent",
        "effects": "none",
        "dataset": "street",
        "scene": scene,
        "method": "adversarial",
    }
    return row | {"score": score, "adversarial_loss": loss} | more


GRID = [
    scored(0.01, 1.0, 0.40, 1.00),
    scored(0.01, 10.0, 0.50, 1.03),  # nearly equal: 10 is chosen at alpha 0.01
    scored(0.1, 1.0, 0.45, 0.50),
    scored(0.1, 10.0, 0.70, 2.00),
]


def test_alpha_by_the_auc_under_the_lambda_that_each_alpha_gets() -> None:
    frame = pd.DataFrame(GRID)
    lambdas = {key[2]: choice.chosen for key, choice in choose_lambdas(frame).items()}
    assert lambdas == {0.01: 10.0, 0.1: 1.0}
    ((_, choice),) = choose_alphas(frame).items()
    assert choice.found == {0.01: pytest.approx(0.50), 0.1: pytest.approx(0.45)} and choice.chosen == 0.1


def test_a_search_without_a_step_size_has_no_alpha_to_choose() -> None:
    assert choose_alphas(pd.DataFrame(GRID).assign(search="random_family_within95")) == {}
    assert choose_alphas(pd.DataFrame(GRID).assign(search="descent_pca10"))


def test_the_lowest_alpha_of_equal_ones_and_means_over_vehicles_not_over_scenes() -> None:
    rows = [scored(alpha, None, 0.3, 1.0, mode="pose") for alpha in (0.1, 0.01)]
    assert next(iter(choose_alphas(pd.DataFrame(rows)).values())).chosen == 0.01
    rows = [scored(0.01, 1.0, 0.9, 1.0, f"s{i}") for i in range(3)] + [scored(0.01, 1.0, 0.1, 1.0, vehicle="suv")]
    rows += [row | {"alpha": 0.1, "score": 0.6} for row in rows]
    assert next(iter(choose_alphas(pd.DataFrame(rows)).values())).found[0.01] == pytest.approx(0.5)


def test_scenes_that_one_candidate_lacks_count_for_none() -> None:
    rows = [*GRID, scored(0.01, 1.0, 0.0, 0.0, "s1")]
    found = {key[2]: choice for key, choice in choose_lambdas(pd.DataFrame(rows)).items()}
    assert found[0.01].found == {1.0: pytest.approx(1.0), 10.0: pytest.approx(1.03)} and found[0.01].tasks == 1


def test_there_is_no_choice_between_candidates_of_different_scenes() -> None:
    rows = [scored(0.01, 1.0, 0.4, 0.2, "s0"), scored(0.01, 10.0, 0.5, 0.9, "s1")]
    assert choice_rows(pd.DataFrame(rows), "s", {40}) == []
    rows = [scored(alpha, None, 0.3, 1.0, scene, mode="pose") for alpha, scene in ((0.1, "s0"), (0.01, "s1"))]
    assert choice_rows(pd.DataFrame(rows), "s", {40}) == []


def test_who_else_scores_has_no_say() -> None:
    rows = [*GRID, *(row | {"scored_by": "sst", "adversarial_loss": 0.0, "score": 0.0} for row in GRID[1:2])]
    assert choose_lambdas(pd.DataFrame(rows)).keys() == choose_lambdas(pd.DataFrame(GRID)).keys()
    assert choose_alphas(pd.DataFrame(rows)) == choose_alphas(pd.DataFrame(GRID))


def test_every_candidate_is_a_row_and_the_reason_names_its_numbers() -> None:
    table = table_from_rows("choices", choice_rows(pd.DataFrame(GRID), "hyperparameters", {40})).to_pandas()
    assert len(table) == 2 + 2 * 2
    assert table.groupby(["parameter", "alpha"], dropna=False)["chosen"].sum().tolist() == [1, 1, 1]
    whys = list(dict.fromkeys(table["why"]))
    assert whys == [
        "alpha 0.1 for the shape: the AUC of what was found is the lowest, 0.450 (next: 0.500 at 0.01), in searches of "
        "40 steps.",
        "lambda 10 for the coupe at alpha 0.01: its mean adversarial loss, 1.030, is within 5% of the lowest, 1.000 at "
        "1, and lambda is larger.",
        "lambda 1 for the coupe at alpha 0.1: its mean adversarial loss, 0.500, is the lowest, and no larger lambda "
        "comes within 5% of it.",
    ]
    assert reasons(table) == whys
    alpha, weight = choice_tables(table)
    assert alpha.header == ["", "alpha 0.01", "alpha 0.1", "chosen", "paper"]
    assert alpha.lines == [["shape", "0.500", "0.450", "0.1", "0.01"]]
    assert weight.lines[0] == ["coupe, alpha 0.01", "1.000", "1.030", "10", "10"]


def test_without_a_choice_nothing_is_said() -> None:
    assert choice_rows(pd.DataFrame(GRID[:1]), "s", {40}) == []
    empty = table_from_rows("choices", []).to_pandas()
    assert choice_tables(empty) == [] and reasons(empty) == []


def test_the_papers_choices() -> None:
    assert [papers_choice("lambda", name) for name in ("coupe", "sports_car", "suv", "convertible", "beach_wagon")] == [
        10, 10, 1, 1, 1]  # fmt: skip
    assert papers_choice("alpha", "pose") == 0.01 and papers_choice("lambda", "van") is None


def test_choices_of_several_modes_differ_in_words_and_lines() -> None:
    """Shape prefers the smaller lambda, shape and pose together the larger one."""
    rows = [
        scored(0.01, weight, 0.4, loss, mode=mode)
        for mode, losses in (("shape", (0.2, 0.9)), ("shape_pose", (0.9, 0.2)))
        for weight, loss in zip((1.0, 10.0), losses)
    ]
    table = table_from_rows("choices", choice_rows(pd.DataFrame(rows), "sweep", {40})).to_pandas()
    shape, both = reasons(table)
    assert shape.startswith("lambda 1 for the coupe at alpha 0.01, mode shape:")
    assert both.startswith("lambda 10 for the coupe at alpha 0.01, mode shape_pose:")
    (lines,) = (one.lines for one in choice_tables(table))
    assert [line[0] for line in lines] == ["coupe, mode shape", "coupe, mode shape_pose"]
