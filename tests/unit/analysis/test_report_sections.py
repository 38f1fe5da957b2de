"""Sections of the report: their numbers are those of the tables."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
import valid_sweeps
from analysed import blocks_html, two_vehicles, variant

from shift3d.analysis.cases.rendered import PageCache, Rendered
from shift3d.analysis.cases.selection import Case, hardest, random_positions
from shift3d.analysis.html.sections.auc import auc, auc_blocks, differences
from shift3d.analysis.html.sections.bev import bev, pooled_cells
from shift3d.analysis.html.sections.cases import _left_out, what_changed
from shift3d.analysis.html.sections.curves import curves
from shift3d.analysis.html.sections.gallery import gallery
from shift3d.analysis.html.sections.overview import coverage, overview
from shift3d.analysis.html.sections.patterns import patterns
from shift3d.analysis.html.sections.retrieval import retrieval
from shift3d.analysis.html.sections.stability import stability
from shift3d.analysis.html.sections.summary import headline
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.paired import paired
from shift3d.analysis.tables.auc import auc_table
from shift3d.analysis.tables.coverage import coverage_lines
from shift3d.analysis.variants import variants
from shift3d.settings.compose import compose_sweep
from shift3d.sweep.planning.plan import make_plan


def test_areas_are_the_mean_scores_with_the_papers_beside_them() -> None:
    scores = {("baseline", "coupe"): [0.9, 0.7], ("baseline", "suv"): [0.6, 0.8]}
    scores |= {("adversarial", "coupe"): [0.2, 0.4], ("adversarial", "suv"): [0.5, 0.4]}
    shown = blocks_html(auc_blocks(variant(scores)))
    for area in ("0.800", "0.700", "0.750", "0.300", "0.450", "0.375"):
        assert f"<td>{area}<small>" in shown
    assert "<small>2 scenes</small>" in shown and "<td>0.50<small>[" in shown and "tab:auc_z" in shown
    for paper in ("0.755", "0.466", "0.469", "0.716", "0.728"):
        assert f"<td>{paper}</td>" in shown
    short = headline(variant(scores))
    assert (
        "from 0.750 to 0.375, a ratio of 0.50 [" in short and f"paper: {(0.466 + 0.469) / (0.755 + 0.755):.2f}" in short
    )
    assert short.count(".") - len(re.findall(r"\d\.\d", short)) == 1, "one sentence"


def test_the_ratio_is_over_the_tasks_and_vehicles_that_have_both_scores() -> None:
    """The van was never scored, and one of the suv's searches has no score: neither baseline counts."""
    scores = {("baseline", "suv"): [0.9, 0.1], ("adversarial", "suv"): [0.45], ("baseline", "van"): [0.9, 0.9]}
    part = variant(scores)
    assert "the mean AUC of 1 vehicle in 1 scene falls from 0.900 to 0.450" in headline(
        part
    ) and "a ratio of 0.50" in headline(part)
    (line,) = [line for line in auc_table(part).lines if line[0] == "adversarial"]
    assert line[-1] == "0.50"


def test_the_unnatural_shapes_stand_in_the_sentence_of_the_ratio() -> None:
    scores = {("baseline", "suv"): [0.8, 0.8, 0.8], ("adversarial", "suv"): [0.6, 0.2, 0.1]}
    some = headline(variant(scores, natural={"suv-0": True, "suv-1": False, "suv-2": False}))
    assert "a ratio of 0.37" in some and "but 2 of 3 shapes are unnatural (ratio over 1 natural shape: 0.75)." in some
    every = {f"suv-{scene}": True for scene in range(3)}
    assert "all 3 shapes are natural" in headline(variant(scores, natural=every))
    assert "was not measured" in headline(variant(scores, natural={}))
    steps = {"suv-0": 0, "suv-1": 3, "suv-2": 3}
    kept = headline(variant(scores, natural={"suv-1": True, "suv-2": True}, best_step=steps))
    assert "1 of 3 tasks unchanged by the search, and all 2 shapes are natural." in kept
    assert "natural" not in headline(variant(scores, best_step=dict.fromkeys(every, 0))), "no shape was found"
    assert "natural" not in headline(variant(scores, mode="pose"))


def test_vehicles_that_the_paper_has_not_are_named() -> None:
    shown = blocks_html(auc_blocks(variant({("baseline", "van"): [0.9, 0.7], ("adversarial", "van"): [0.2, 0.4]})))
    assert "tab:auc_z" not in shown and "The paper has no table of these vehicles" in shown


def test_the_gallery_draws_over_all_tasks_whatever_became_of_them(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost, stayed = (task.spec.task_id for task in sweep.plan.tasks)
    scores = sweep.scores.copy()
    own = scores["task_id"] == lost
    scores.loc[own, "score"], scores.loc[own, "status"] = np.nan, "no_placement"
    scores.loc[(scores["task_id"] == stayed) & (scores["method"] == "adversarial"), "status"] = "no_valid_step"
    shown = blocks_html(gallery(dataclasses.replace(sweep, scores=scores), PageCache(sweep.plan)))
    assert shown.count("<figure>") == 2 and "no placement" in shown and ", no valid step<" in shown
    assert "All 2 tasks" in shown and "0.90 → 0.30" in shown


def test_the_gallery_names_the_kind_that_a_search_turned_to(finished: Path) -> None:
    sweep = read_sweep(finished)
    for kind, words in ((None, "suv, shape"), ("box_van", "suv to box van, shape")):
        solutions = sweep.solutions.assign(drawn_as=kind)
        shown = blocks_html(gallery(dataclasses.replace(sweep, solutions=solutions), PageCache(sweep.plan)))
        assert words in shown


def test_the_draw_is_seeded_and_every_task_is_as_likely() -> None:
    counts = np.zeros(20)
    for number in range(400):
        counts[random_positions(20, 5, f"{number:x}")] += 1
    assert random_positions(20, 5, "a") == random_positions(20, 5, "a") != random_positions(20, 5, "b")
    assert random_positions(3, 50, "a") == [0, 1, 2]
    assert np.abs(counts - 100).max() < 4 * np.sqrt(400 * 0.25 * 0.75)


def test_differences_are_paired_by_task_and_tested_by_scene() -> None:
    found = two_vehicles()
    result = paired(found.rows, "adversarial", "baseline")
    assert result is not None and (result.scenes, result.tasks) == (12, 24)
    base = found.rows[found.rows["method"] == "baseline"]["score"]
    assert result.interval.mean == pytest.approx(-0.5 * base.mean())
    assert result.p_value == pytest.approx(2 / 2**12)  # every scene falls: the least that 12 scenes can give
    assert paired(found.rows, "random", "baseline") is None
    shown = blocks_html(differences([found]))
    assert f"{-0.5 * base.mean():+.3f}" in shown and "4.9e-04" in shown and "<td>0.001</td>" in shown


def test_the_gain_over_random_draws_and_the_effect_of_an_edit_are_differences() -> None:
    base, drawn = [0.9, 0.8, 0.7], [0.6, 0.5, 0.7]
    scores = {("baseline", "suv"): base, ("random_budget", "suv"): drawn, ("edited", "suv"): [0.7, 0.6, 0.5]}
    shown = blocks_html(differences([variant(scores | {("adversarial", "suv"): [0.3, 0.2, 0.1]})]))
    for pair, expected in (("adversarial - best of random draws", -0.4), ("edited - baseline", -0.2)):
        line = shown[shown.index(pair) :]
        assert f"<td>{expected:+.3f}</td>" in line[: line.index("</tr>")]


def test_curves_have_a_panel_a_vehicle_and_one_of_all_with_bands() -> None:
    shown = blocks_html(curves([two_vehicles()]))
    assert shown.count('class="plot"') == 3 and shown.count("tonexty") == 6
    assert "all vehicles: 12 scenes, 24 tasks" in shown and "no band" not in shown
    one = curves([variant({("baseline", "suv"): [0.9], ("adversarial", "suv"): [0.1]})])
    assert "no band" in blocks_html(one)


def test_cells_pool_vehicles_by_their_scores(finished: Path) -> None:
    sweep = read_sweep(finished)
    (found,) = variants(sweep.auc, sweep.scored)
    cells = sweep.bev[sweep.bev["method"] == "adversarial"]
    more = cells.assign(scores=3, mean_reduction=-0.2)
    grid = dataclasses.replace(sweep, bev=pd.concat([cells, more]))
    pooled = pooled_cells(grid.bev, found)
    own = cells.iloc[0]
    expected = (own["scores"] * own["mean_reduction"] - 0.6) / (own["scores"] + 3)
    assert pooled["mean_reduction"].iloc[0] == pytest.approx(expected)
    assert "1 cells of 10 m" in blocks_html(bev(grid, [found]))
    empty = dataclasses.replace(sweep, bev=sweep.bev.iloc[:0])
    assert "there is no grid" in blocks_html(bev(empty, [found]))


def test_the_hardest_are_of_other_vehicles_and_scenes_first() -> None:
    falls = {("a", "suv", "1"): 0.8, ("b", "suv", "1"): 0.7, ("c", "coupe", "1"): 0.3, ("d", "coupe", "2"): 0.2,
             ("e", "van", "3"): -0.1, ("f", "van", "4"): 0.009}  # fmt: skip
    rows = [
        {"task_id": task, "vehicle": vehicle, "scene": scene, "mode": "shape", "detector": "p", "scored_by": "p"}
        | {"method": method, "replicate": 0, "score": 0.9 if method == "baseline" else 0.9 - fall}
        for (task, vehicle, scene), fall in falls.items()
        for method in ("baseline", "adversarial")
    ]
    frame = pd.DataFrame(rows)
    assert [case.task_id for case in hardest(frame, 2)] == ["a", "d"]
    assert [case.task_id for case in hardest(frame, 9)] == ["a", "b", "c", "d"]
    assert hardest(frame[frame["method"] == "baseline"]) == []
    # Shapes that are not a car come last, and only if there are not enough others.
    assert [case.task_id for case in hardest(frame, 2, {"a", "d"})] == ["b", "c"]
    assert [case.task_id for case in hardest(frame, 3, {"a", "d"})] == ["b", "c", "d"]


def test_one_unnatural_case_is_one() -> None:
    chosen = hardest(pd.DataFrame(
        {"task_id": task, "vehicle": task, "scene": "s", "mode": "shape", "detector": "p", "scored_by": "p"}
        | {"method": method, "replicate": 0, "score": score}
        for task in "ab"
        for method, score in (("baseline", 0.9), ("adversarial", 0.3))
    ))  # fmt: skip
    assert _left_out({"a"}, chosen) == " The last one is unnatural, because too few scores of other shapes fell."
    assert _left_out({"a", "b"}, chosen) == " The last 2 are unnatural, because too few scores of other shapes fell."


def test_variants_name_what_differs_and_shape_comes_first(finished: Path) -> None:
    sweep = read_sweep(finished)
    (alone,) = variants(sweep.auc, sweep.scored)
    assert (alone.label, alone.vehicles) == ("adversarial shape", ["suv"])
    assert alone.methods == ["baseline", "random", "adversarial"]
    assert isinstance(sweep, Sweep) and sweep.scored["place"].nunique() == 2


def test_what_is_unstable_is_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    rows = [
        {"task_id": f"task{index}", "vehicle": "suv", "scene": "north", "mode": "shape", "lambda": 1.0}
        | {"scored_by": "pointpillars", "method": "adversarial", "replicate": 0, "score": 0.3, "score_again": 0.3}
        | {"search": "descent", "alpha": 0.01, "detector": "pointpillars", "accuracy": "standard"}
        | {"robust": index > 1, "margin": 0.5, "least_margin_noise": 0.4, "least_margin_nearby": 0.4}
        | {"score_reference": 0.3 if index else 0.55, "stable": index > 0, "cause": "of <300> hits 9 missed"}
        for index in range(4)
    ]
    shown = blocks_html(stability(dataclasses.replace(sweep, verification=pd.DataFrame(rows))))
    assert "<td>4</td><td>1</td><td>75.0%</td><td>2.5e-01</td><td>100%</td><td>50%</td>" in shown
    assert shown.count("of &lt;300&gt; hits 9 missed") == 1 and "task0" in shown


def test_a_section_names_no_command_that_refuses_the_sweep(finished: Path) -> None:
    sweep = read_sweep(finished)
    empty, posed = sweep.solutions.iloc[:0], sweep.solutions.assign(mode="pose")
    made = {
        "verify": stability,
        "patterns": patterns,
        "retrieve": lambda found: retrieval(found, PageCache(found.plan)),
    }
    for command, section in made.items():
        assert f"shift3d {command}" in blocks_html(section(sweep))
        nothing = dataclasses.replace(sweep, solutions=empty, scores=sweep.scores.assign(score=np.nan))
        shown = blocks_html(section(nothing))
        assert "shift3d" not in shown and "No task" in shown
    assert "shift3d" not in blocks_html(made["retrieve"](dataclasses.replace(sweep, solutions=posed)))


def test_the_page_names_the_detection_radius_of_the_sweep(finished: Path) -> None:
    near = compose_sweep("smoke", ["vehicle=suv", "mode=shape", "attack.detection_radius_m=2"])
    sweep = dataclasses.replace(read_sweep(finished), plan=make_plan(near, valid_sweeps.catalogue)[0])
    assert "detection_radius_m 2.0" in blocks_html(overview(sweep))
    assert "attack.detection_radius_m (5 m by default)" in blocks_html(auc(sweep, [two_vehicles()]))


def test_failures_are_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost, kept = (task.spec.task_id for task in sweep.plan.tasks)
    scores = sweep.scores[sweep.scores["task_id"] == kept]
    failed = {"outcome": "failed", "quarantined": True, "error": "ValueError: <no>"}
    attempts = sweep.attempts.assign(outcome="done", quarantined=False, error=None).astype({"error": object})
    attempts.loc[attempts["task_id"] == lost, list(failed)] = list(failed.values())
    found = dataclasses.replace(sweep, scores=scores, attempts=attempts.drop_duplicates("task_id"))
    shown = blocks_html(coverage(found))
    assert "1 of 2 tasks scored" in shown and "1 quarantined" in shown
    assert f"{lost}  ValueError: &lt;no&gt;" in shown and "No attempt failed" not in shown


def test_a_call_that_was_lost_counts_once_however_many_tasks_it_held(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost = sweep.attempts.drop_duplicates("task_id").assign(
        outcome="node_lost", quarantined=False, worker="a:1", started_unix_s=1e9, seconds=60.0
    )
    again = lost.head(1).assign(attempt=2, started_unix_s=2e9)
    assert len(lost) == 2
    shown = blocks_html(coverage(dataclasses.replace(sweep, attempts=pd.concat([lost, again]))))
    assert "2 attempts failed and took 120 s" in shown


def test_a_machine_that_was_left_out_is_named_once(finished: Path) -> None:
    sweep = read_sweep(finished)
    line = "host-a is left out: /data: no such folder. Mount it"
    unloaded = sweep.attempts.drop_duplicates("task_id").assign(outcome="not_loaded", error=line, worker="host-a:1")
    attempts = pd.concat([unloaded, sweep.attempts])
    shown = blocks_html(coverage(dataclasses.replace(sweep, attempts=attempts)))
    assert shown.count(line) == 1 and "No attempt failed" not in shown
    many = pd.concat([unloaded.head(1).assign(error=f"host-{number} is left out") for number in range(6)])
    assert coverage_lines(sweep.scores, many, 2, shown=5)[-1] == "  and 1 more machine"


@pytest.mark.parametrize("mode", ["shape", "pose", "shape_pose"])
def test_a_case_says_of_its_shape_and_its_place_what_its_mode_changes(mode: str) -> None:
    def rendered(length_m: float, x_m: float) -> Rendered:
        theta, nothing = np.array([x_m, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros((0, 2))
        mesh = trimesh.creation.box((length_m, 1.8, 1.5))
        return Rendered(mesh, theta, nothing, nothing, 100, np.zeros(7), None, 0.5)

    case = Case("id", "suv", "street", mode, 0.8, 0.2)
    longer, farther = 4.0 + 0.4 * ("shape" in mode), 12.0 + 0.5 * ("pose" in mode)
    text = what_changed(case, rendered(4.0, 12.0), rendered(longer, farther))
    assert ("40 cm longer" in text) == ("shape" in mode) and ("moved 50 cm forward" in text) == ("pose" in mode)
    assert ("the shape is the baseline's" in text) == (mode == "pose")
