"""Advice on a frontier: words and table agree with the numbers."""

from __future__ import annotations

import re

from frontier_by_hand import frame_of, frontier_row, march, small_rows, with_depth

from shift3d.analysis.tables.accuracy.advice import advice
from shift3d.analysis.tables.accuracy.frontier import frontier_lines
from shift3d.analysis.tables.table import factor, length, milliseconds, share


def test_the_advice_cites_the_numbers_that_follow_from_the_rows() -> None:
    text = advice(frame_of(small_rows()))
    assert "\n" not in text
    for sentence in (
        "On the street scenes (10 renderings, 10,000 hits) draft takes 1 ms, standard 2 ms, paper 800 ms and "
        "reference 5 s a rendering.",
        "The default, standard, is 400 times as fast as paper as published (100 times as fast as paper on the "
        "sphere's chord only), and misses or misplaces none of the hits; paper misses or misplaces 0.5 %.",
        "Its depth error is at most 1 µm for half of the hits, 10 µm for 99 % and 460 µm for all; it misses none of "
        "the hits whose chord is 2 cm or longer; the cosine between its gradient and reference's is 0.9995, and the "
        "AUC changes by -0.002.",
        "counts 1 m for each misplaced beam, its error is at most 10 µm per beam.",
        "The faster preset, draft, saves 50 % of the time, with an error of 2 mm instead of 10 µm and 0.1 % of the "
        "hits misplaced instead of none.",
        "The more accurate preset, reference, takes 2,500 times the time, with an error of 0 instead of 10 µm.",
        "standard takes 0.5 ms: 4 times as fast as cold and 1,600 times as fast as paper as published.",
        "A whole attack step with standard takes 25 ms, 320 times as fast as the published step.",
        "The knee of the Pareto front is standard (2 ms, error 10 µm): the next faster setting, draft, saves 50 % of "
        "the time at 200 times the error; the next more accurate setting, reference, takes 2,500 times the time at an "
        "error of 0.",
        # Their error is 20, 10, 5 and 6 mm: draft is more accurate than all of them, and standard slower.
        "draft dominates march 0.1 m to march 0.4 m (100 to 400 times), paper (800 times).",
    ):
        assert sentence in text
    assert "quartiles" not in text and "not on the Pareto front" not in text


def test_a_preset_behind_the_front_and_a_tie_in_time_are_said() -> None:
    rows = [
        frontier_row("standard", 2.0, preset="standard", **with_depth(1e-4)),
        frontier_row("secant", 1.9, method="secant", **with_depth(1e-5)),
    ]
    text = advice(frame_of(rows))
    assert "standard is not on the Pareto front." in text
    assert "secant dominates standard (1.05 times)." in text
    assert "For standard the quartiles of the two times overlap" in text
    apart = [rows[0] | {"ms_low": 1.99}, rows[1] | {"ms_high": 1.95}]
    assert "quartiles" not in advice(frame_of(apart))


def test_settings_between_which_another_is_not_dominated_are_not_one_run() -> None:
    rows = [march(0.4, 10.0, 1e-2), march(0.3, 11.0, 1e-2), march(0.2, 3.0, 1e-6), march(0.1, 12.0, 1e-2)]
    text = advice(frame_of([*rows, march(0.05, 13.0, 1e-2)]))
    assert "march 0.2 m dominates march 0.05 m (4.33 times), march 0.1 m (4 times), march 0.3 m (3.67 times)" in text


def test_advice_without_presets_without_paper_and_on_two_scene_sets() -> None:
    (one,) = advice(frame_of([march(0.1, 2.0, 1e-3)])).split("\n\n")
    assert one == (
        "On the street scenes (10 renderings, 10,000 hits) no preset was measured; the fastest setting, march 0.1 m, "
        "takes 2 ms a rendering. No setting is dominated."
    )
    assert "(1 rendering, 10,000 hits)" in advice(frame_of([march(0.1, 2.0, 1e-3) | {"renders": 1}]))
    rows = small_rows()
    both = advice(frame_of([*rows, *(row | {"scenes": "kitti"} for row in rows[4:6])])).split("\n\n")
    assert both[0] == advice(frame_of(rows))
    assert both[1].startswith("On the kitti scenes") and "paper" not in both[1]
    assert advice(frame_of(rows)) == advice(frame_of(rows))


def test_the_table_has_the_fastest_first_and_no_column_that_nothing_was_measured_for() -> None:
    table, legend = frontier_lines(frame_of(small_rows())).split("\n\n")
    lines = table.splitlines()
    assert legend.startswith("time: median time of one rendering; x paper: ")
    assert [line[:14].strip() for line in lines[3:]] == [
        *("standard, warm", "draft", "standard", "march 0.4 m", "march 0.2 m", "march 0.1 m", "paper", "reference"),
    ]
    cells = dict(zip(re.split(r"\s{2,}", lines[1].strip()), re.split(r"\s{2,}", lines[5].strip())))
    assert cells | {"street": "standard", "time": "2 ms", "x paper": "400", "p99": "10 µm", "front": "*"} == cells
    assert cells | {"cosine": "0.999500", "AUC": "-2.0e-03", "step": "25 ms", "missed": "0"} == cells
    assert lines[3].endswith("*") and not lines[9].endswith("*") and " - " in lines[4]
    plain = [
        row | dict.fromkeys(("gradient_cosine", "auc_delta", "step_ms_median", "step_ratio_to_paper"))
        for row in small_rows()
    ]
    assert not {"cosine", "AUC", "step"} & set(frontier_lines(frame_of(plain)).splitlines()[1].split())


def test_numbers_as_people_read_them() -> None:
    lengths = [0.0, 3.2e-9, 4.567e-8, 1e-6, 0.00099951, 0.0123, 1.5]
    assert [length(v) for v in lengths] == ["0", "3.2 nm", "45.7 nm", "1 µm", "1 mm", "12.3 mm", "1.5 m"]
    assert [milliseconds(v) for v in (0.0312, 8.0, 812.3, 999.7, 5310.0)] == [
        *("0.0312 ms", "8 ms", "812 ms", "1 s", "5.31 s"),
    ]
    assert [share(v) for v in (0.0, 5e-5, 0.0034, 1.0)] == ["0", "0.005 %", "0.34 %", "100 %"]
    assert [factor(v) for v in (1.0, 1.2345, 387.2, 12345.0)] == ["1", "1.23", "387", "12,300"]


def test_a_setting_with_a_gradient_is_no_step_of_the_front_without() -> None:
    """The setting is on the front because nothing faster has a gradient, but is neither faster nor more accurate."""
    rows = [
        frontier_row("draft", 1.0, preset="draft", **with_depth(1e-2)),
        frontier_row("standard", 2.0, preset="standard", **with_depth(1e-5)),
        frontier_row("draft, shape gradient", 3.5, gradient="shape", **with_depth(5e-3)),
        frontier_row("reference", 5000.0, preset="reference"),
    ]
    text = advice(frame_of(rows))
    assert "front is standard" in text and "the next more accurate setting, reference," in text
    assert "knee" not in advice(frame_of(rows[:3]))
