"""Rows from outcomes whose right answers can be worked out on paper."""

from __future__ import annotations

import dataclasses

import pytest
from frontier_settings_by_hand import look, outcome, setting

from shift3d.accuracy_time.rows import CaseResults, frontier_rows
from shift3d.accuracy_time.run import CaseResult
from shift3d.store.frontier_table import frontier_table

STANDARD = setting("standard", preset="standard")
PAPER = setting("paper", "paper", preset="paper", displaced=False)


def result(samples_ms: tuple[float, ...] = (10.0,), displaced: object = None, **changes: object) -> CaseResult:
    found = look(**changes)
    return CaseResult(found, displaced, (found,), samples_ms)  # type: ignore[arg-type]


def row_of(*results: CaseResult) -> dict[str, object]:
    cases = [CaseResults("street", 500, {"standard": found}) for found in results]
    (row,) = frontier_rows([STANDARD], cases)
    return row


def test_counts_are_pooled_over_both_shapes_of_all_cases() -> None:
    first = result(missed=3, missed_thick=1, wrong=2, false=5, displaced=outcome(missed=1, hits=300, thick_hits=240))
    row = row_of(first, result(unresolved=2))
    assert (row["renders"], row["hits"], row["beams"]) == (3, 500, 1000)
    assert row["missed_hits"] == 4 / 500 and row["missed_hits_2cm"] == 1 / 400
    assert row["wrong_surface"] == 2 / 500 and row["false_hits"] == 5 / 500
    assert row["evaluations_per_beam"] == 2.0 and row["unresolved_beams"] == 2


def test_depth_errors_are_pooled_before_their_quantiles_are_taken() -> None:
    row = row_of(result(depth_m=[0.0] * 98), result(depth_m=[0.004, 0.008, 0.002]))
    assert row["depth_p50_m"] == 0.0 and row["depth_p99_m"] == 0.004 and row["depth_max_m"] == 0.008


def test_times_are_means_over_cases_of_the_quartiles_of_repeats() -> None:
    row = row_of(result((1.0, 2.0, 3.0)), result((100.0, 110.0, 120.0)))
    assert (row["ms_low"], row["ms_median"], row["ms_high"]) == ((1.5 + 105) / 2, 56.0, (2.5 + 115) / 2)


def test_of_gradients_the_worst_case_stands_in_the_row() -> None:
    row = row_of(result(cosines=[0.99, 1.0], norm_ratios=[1.1]), result(cosines=[0.999], norm_ratios=[0.8, 1.0]))
    assert row["gradient_cosine"] == 0.99 and row["gradient_norm_ratio"] == 0.8


def test_changes_of_the_score_cancel_in_the_auc_and_not_in_the_score() -> None:
    row = row_of(result(score=0.93), result(score=0.87))
    assert row["score_delta"] == pytest.approx(0.03) and row["auc_delta"] == pytest.approx(0.0, abs=1e-12)


def test_ratios_are_to_the_preset_paper_of_the_same_scenes_and_null_without_it() -> None:
    def case(scenes: str, paper_ms: float) -> CaseResults:
        results = {"standard": result((10.0,)), "paper": result((paper_ms,), render_ms=paper_ms)}
        return CaseResults(scenes, 500, results)

    rows = frontier_rows([STANDARD, PAPER], [case("street", 4000.0), case("kitti", 6000.0)])
    assert [(row["scenes"], row["setting"], row["ratio_to_paper"]) for row in rows] == [
        ("street", "standard", 400.0),
        ("street", "paper", 1.0),
        ("kitti", "standard", 600.0),
        ("kitti", "paper", 1.0),
    ]
    assert rows[0]["step_ratio_to_paper"] == pytest.approx(4050 / 150)
    alone = row_of(result())
    assert alone["ratio_to_paper"] is None and alone["step_ratio_to_paper"] is None
    frontier_table([*rows])
    frontier_table([alone])


def test_ratios_name_their_paper_as_published_or_on_the_chord_alone() -> None:
    chord = setting("chord", "paper", renderer={"sphere_chord_only": True}, displaced=False)
    results = {"standard": result((10.0,)), "paper": result((4000.0,)), "chord": result((1000.0,))}
    rows = frontier_rows([STANDARD, PAPER, chord], [CaseResults("street", 500, results)])
    assert [row["ratio_to_paper"] for row in rows] == [400.0, 1.0, 4.0]
    assert [row["ratio_to_paper_chord"] for row in rows] == [100.0, 0.25, 1.0]
    assert row_of(result())["ratio_to_paper_chord"] is None


def test_a_row_says_under_which_conditions_it_was_measured() -> None:
    chosen = [
        STANDARD,
        setting("cold", gradient="pose", grid=True),
        setting("warm", warm="shape"),
    ]
    results = {each.name: result() for each in chosen}
    rows = frontier_rows(chosen, [CaseResults("street", 500, results)])
    assert [(row["start"], row["grid"], row["gradient"]) for row in rows] == [
        ("cold", False, "no"),
        ("cold", True, "pose"),
        ("warm", False, "shape"),
    ]
    frontier_table(rows)


def test_the_score_that_attacks_reach_is_the_mean_over_cases_and_modes() -> None:
    assert row_of(result())["attack_score"] is None
    first, second = result(), result()
    attacked = [dataclasses.replace(first, attack={"scores": [0.1, 0.3]})]
    attacked.append(dataclasses.replace(second, attack={"scores": [0.5, 0.7]}))
    assert row_of(*attacked)["attack_score"] == pytest.approx(0.4)


def test_a_rendering_that_found_nothing_still_has_a_row() -> None:
    row = row_of(result(missed=100, missed_thick=80, depth_m=[], hits=100))
    assert row["missed_hits"] == 1.0 and row["depth_max_m"] == 0.0
    frontier_table([row])
