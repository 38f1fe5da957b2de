"""AUC over natural shapes, the ratio's interval, and the grid of other scenes."""

from __future__ import annotations

import dataclasses
import re
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest
import valid_sweeps
from analysed import blocks_html, variant
from scipy.stats import t

from shift3d.analysis.html.sections.auc import auc_blocks
from shift3d.analysis.html.sections.bev import transfer_grid
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.intervals import ratio_interval
from shift3d.analysis.tables.auc import auc_table, input_words, natural_search, natural_table
from shift3d.analysis.tables.paper import paper_table, paper_table_of
from shift3d.analysis.tables.sensors import transfer_table
from shift3d.analysis.tables.table import interval_text
from shift3d.analysis.variants import variants
from shift3d.detectors.names import DetectorName
from shift3d.store.log_entries import read_log
from shift3d.store.tables import table_from_rows
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final
from shift3d.task.exchange import AssetsSpec


def rows_of(scores: list[float], vehicle: str = "suv") -> pd.DataFrame:
    return pd.DataFrame({"score": scores, "vehicle": vehicle, "place": [f"s{i:02}" for i in range(len(scores))]})


def test_the_ratio_is_that_of_the_means_over_vehicles() -> None:
    above = pd.concat([rows_of([0.2, 0.4]), rows_of([0.3], "coupe")])
    below = pd.concat([rows_of([0.8, 0.8]), rows_of([0.4], "coupe")])
    found = ratio_interval(above, below)
    assert found is not None and found.mean == pytest.approx(0.3 / 0.6)
    assert found.low <= found.mean <= found.high
    alone = ratio_interval(rows_of([0.2]), rows_of([0.4]))
    assert alone is not None and alone.mean == 0.5 and np.isinf(alone.high)
    assert ratio_interval(above.iloc[:0], below) is None and ratio_interval(above, rows_of([0.0])) is None


def test_a_constant_ratio_has_a_point_for_an_interval() -> None:
    below = rows_of(list(np.random.default_rng(0).uniform(0.3, 0.9, 30)))
    found = ratio_interval(below.assign(score=0.5 * below["score"]), below)
    assert found is not None and (found.low, found.high) == pytest.approx((0.5, 0.5))


def test_a_reference_that_some_draws_have_nothing_of_but_zeros_leaves_the_ratio_open_above() -> None:
    """A third of the draws of eight scenes lacks the only scene with a score: the ratio in these draws is unbounded."""
    rare = ratio_interval(rows_of([0.1] * 8), rows_of([0.9, *[0.0] * 7]))
    assert rare is not None and rare.mean == pytest.approx(8 / 9)
    assert rare.low < rare.mean and rare.high == np.inf
    assert interval_text(rare, 2, "").endswith(", inf]")
    often = ratio_interval(rows_of([0.1] * 8), rows_of([*[0.9] * 6, 0.0, 0.0]))
    assert often is not None and often.low < often.mean < often.high < np.inf


def test_the_interval_holds_the_ratio_about_as_often_as_it_says() -> None:
    rng, held, times = np.random.default_rng(5), 0, 100
    for _ in range(times):
        hard = rng.uniform(0.5, 1.0, 40)  # hard scenes are hard for both
        below = rows_of(list(hard * rng.uniform(0.8, 1.0, 40)))
        above = rows_of(list(hard * rng.uniform(0.2, 0.6, 40)))
        found = ratio_interval(above, below)
        assert found is not None
        held += found.low <= 0.4 / 0.9 <= found.high
    assert 0.89 <= held / times <= 0.99


def judged_scores(natural: list[bool]) -> pd.DataFrame:
    """Return four tasks; the first two fall from 0.8 to 0.6, the others to 0."""
    scores = []
    for number in range(4):
        task = {"task_id": f"t{number}", "vehicle": "suv", "detector": "p", "alpha": 0.01, "lambda": 1.0}
        task |= {"mode": "shape", "natural": natural[number], "search": "descent", "accuracy": "standard"}
        task |= {"effects": [], "best_step": 3}
        for method, score in (("baseline", 0.8), ("adversarial", 0.6 if number < 2 else 0.0)):
            scores.append(task | {"method": method, "score": score, "scored_by": "p", "replicate": 0})
    return pd.DataFrame(scores)


def last_line(scores: pd.DataFrame) -> list[str]:
    return str(natural_table(scores)).splitlines()[-1].split()


def test_two_searches_are_two_lines() -> None:
    scores = judged_scores([True, True, False, False])
    other = scores.assign(search="random_family", task_id=scores["task_id"] + "r")
    lines = str(natural_table(pd.concat([scores, other]))).splitlines()
    assert [line.split(",")[0] for line in lines[-2:]] == ["descent", "random family"]


def test_natural_shapes_by_lambda() -> None:
    scores = judged_scores([True, True, False, False])
    line = last_line(scores)
    assert line[-9:] == ["2", "of", "4", "0.800", "0.300", "0.37", "0.800", "0.600", "0.75"]
    assert natural_table(scores.assign(natural=None)) is None, "an older program measured none"
    assert natural_table(scores.assign(mode="pose")) is None
    assert last_line(scores.assign(natural=False))[-3:] == ["-", "-", "-"]
    lost = scores[~(scores["task_id"].eq("t0") & scores["method"].eq("baseline"))]
    assert last_line(lost)[-9:-6] == ["1", "of", "3"], "both of a pair or none"


def test_a_shape_that_the_search_left_unchanged_is_not_counted_as_a_natural_shape() -> None:
    scores = judged_scores([True, True, False, False])
    kept = scores.assign(best_step=scores["best_step"].where(scores["task_id"].ne("t0"), 0))
    assert last_line(kept)[-9:-6] == ["1", "of", "3"]
    assert natural_table(scores.assign(best_step=0)) is None


def test_a_sweep_of_unnatural_shapes_names_the_one_that_finds_natural_ones() -> None:
    scores = judged_scores([True, True, False, False]).assign(dataset="street", detector="pointpillars")
    assert natural_search(scores) == "Hard shapes that stay vehicles: shift3d sweep natural"
    frames = natural_search(scores.assign(dataset="kitti"))
    assert frames is not None and frames.endswith("sweep natural scenes=kitti scenes.root=PATH")
    logs = natural_search(scores.assign(dataset="argoverse2"))
    assert logs is not None and logs.endswith("sweep natural scenes=argoverse2 scenes.root=PATH")
    own = natural_search(scores.assign(detector="own"))
    assert own is not None and own.endswith("sweep natural detector=own detector.module=FILE.py")
    cars = natural_search(scores, [AssetsSpec({}, {"kind": "set", "folder": "cars"})] * 2)
    assert cars is not None and cars.endswith("sweep natural vehicle=set vehicle.folder=PATH vehicle.name=NAME")
    instances = natural_search(scores, [AssetsSpec({}, {"kind": "deepsdf", "folder": "cars"})])
    assert instances is not None and instances.endswith("sweep natural"), "its codes have no kinds"
    assert natural_search(scores.assign(natural=True)) is None
    assert natural_search(scores.assign(natural=None)) is None, "not measured"
    assert natural_search(scores.assign(search="expectation_family_within95")) is None, "no command does better"


def test_means_are_those_of_the_vehicles_as_in_the_table_of_aucs() -> None:
    """A suv falls from 0.8 to 0.6 twice, and a coupe once from 0.4 to 0.1."""
    scores = judged_scores([True, True, True, False])
    coupe = scores["task_id"].eq("t2")
    scores.loc[coupe, "score"] = np.where(scores.loc[coupe, "method"] == "baseline", 0.4, 0.1)
    scores.loc[coupe, "vehicle"] = "coupe"
    assert last_line(scores)[-3:] == ["0.600", "0.350", "0.58"]


def test_auc_over_natural_shapes_stands_beside_that_over_all() -> None:
    scores = {("baseline", "suv"): [0.8] * 4, ("adversarial", "suv"): [0.6, 0.6, 0.0, 0.0]}
    found = variant(scores, natural={f"suv-{number}": number < 2 for number in range(4)})
    shown = blocks_html(auc_blocks(found))
    assert "adversarial, natural shapes" in shown and "2 of 4 adversarial shapes (suv 2 of 4)" in shown
    assert "<td>0.300<small>" in shown and "<td>0.600" in shown and "<td>0.75</td>" in shown
    printed = str(auc_table(found)).splitlines()
    assert printed[-2].split()[-3:] == ["0.600", "0.600", "0.75"]
    unknown = dataclasses.replace(found, rows=found.rows.assign(natural=None))
    assert "natural shapes" not in blocks_html(auc_blocks(unknown))


def test_the_papers_sst_stands_beside_the_small_one() -> None:
    assert paper_table("shape", "sst_small", "sst_small") == paper_table("shape", "sst", "sst")
    assert paper_table("pose", "sst_small", "pointpillars") == paper_table("pose", "sst", "pointpillars")


def test_the_paper_stands_beside_its_own_search_alone() -> None:
    of_paper = variant({("baseline", "suv"): [0.8, 0.7], ("baseline", "van"): [0.8, 0.7]})
    assert paper_table_of(of_paper) == paper_table("shape", "pointpillars", "pointpillars")
    assert paper_table_of(dataclasses.replace(of_paper, search="expectation_parameters")) is None
    assert paper_table_of(variant({("baseline", "van"): [0.8, 0.7]})) is None


def transfers(places: int = 6) -> pd.DataFrame:
    """Return a suv that falls from 0.8 to 0.4 in every scene, a coupe with 0.4 in all, and a scene without room."""
    group = {
        "mode": "shape",
        "search": "descent",
        "lambda": 1.0,
        "alpha": 0.01,
        "detector": "p",
        "scored_by": "p",
        "dataset": "d",
    }
    rows = []
    for number in range(places):
        there = group | {"scene": f"home{number}", "other_scene": f"s{number}"}
        rows.append(there | {"vehicle": "suv", "score_baseline": 0.8, "score": 0.4})
        rows.append(there | {"vehicle": "coupe", "score_baseline": 0.4, "score": 0.4})
    rows.append(
        group | {"vehicle": "suv", "scene": "home", "other_scene": "full", "score_baseline": None, "score": None}
    )
    return pd.DataFrame(rows)


def test_shapes_in_other_scenes_by_their_vehicles_means() -> None:
    line = str(transfer_table(transfers())).splitlines()[-1].split()
    assert line[-8:] == ["12", "6", "0.600", "0.400", "0.67", "[0.67,", "0.67]", "50%"]
    assert transfer_table(transfers(0)) is None
    assert "(one scene)" in str(transfer_table(transfers(1))), "one scene has no interval"


def test_what_shapes_do_elsewhere_is_as_uncertain_as_so_many_shapes_leave_it() -> None:
    """Nine shapes, some of which are missed everywhere, are put into twelve other scenes each."""
    known = transfers(1).iloc[0].to_dict()
    ends = [0.1, 0.7] * 4 + [0.1]
    rows = pd.DataFrame(
        known | {"scene": f"home{shape}", "other_scene": f"s{place}", "score_baseline": 0.8, "score": score}
        for shape, score in enumerate(ends)
        for place in range(12)
    )
    table = transfer_table(rows)
    assert table is not None
    mean, low, high = map(float, re.findall(r"[0-9.]+", str(table.lines[0][-2])))
    half = t.ppf(0.975, 8) * float(np.std(ends)) / 3 / 0.8
    assert mean == pytest.approx(np.mean(ends) / 0.8, abs=0.01)
    assert (low, high) == pytest.approx((mean - half, mean + half), abs=0.15 * half)
    alone = transfer_table(rows[rows["scene"] == "home0"])
    assert alone is not None and "(one scene)" in str(alone.lines[0][-2]), "one shape says nothing of others"


def test_placements_under_other_effects_or_accuracies_have_lines_of_their_own() -> None:
    rows = transfers()
    clear = rows.assign(effects=[[] for _ in range(len(rows))], accuracy="standard")
    fog = rows.assign(effects=[["fog"] for _ in range(len(rows))], accuracy="standard", score=rows["score"] / 2)
    table = transfer_table(pd.concat([clear, fog], ignore_index=True))
    assert table is not None
    shown = [(line[0].split(", ")[-1], dict(zip(table.header, line))["shape"]) for line in table.lines]
    assert shown == [("no effects", "0.400"), ("fog", "0.200")]
    alone = transfer_table(clear)
    assert alone is not None and str(alone) == str(transfer_table(rows))


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Sweep:
    folder = tmp_path_factory.mktemp("cars") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return read_sweep(folder)


def test_the_transfer_grid_marks_cells_that_nothing_was_put_into(sweep: Sweep) -> None:
    found = variants(sweep.auc, sweep.scored)
    assert "put no shape into another scene" in blocks_html(transfer_grid(sweep, found))
    row = found[0].rows.iloc[0]
    group: dict[str, Any] = {name: row[name] for name in ("sweep", "dataset", "vehicle", "mode", "lambda", "alpha",
                                                          "detector", "accuracy", "search", "effects",
                                                          "scored_by")}  # fmt: skip
    cells = []
    for x in (-20.0, -10.0, 0.0, 10.0):
        filled = x == 10.0
        values = {"scores": 3 if filled else 0, "mean_score_baseline": 0.9 if filled else None}
        values |= {"mean_score": 0.5 if filled else None, "mean_reduction": 0.4 if filled else None}
        cells.append({**group, "method": "adversarial", "cell_x_m": x, "cell_y_m": 0.0, "cell_size_m": 10.0, **values})
    grid = table_from_rows("bev_transfer", cells).to_pandas()
    shown = blocks_html(transfer_grid(dataclasses.replace(sweep, bev_transfer=grid), found))
    assert "falls in 1 of 1 cells of 10 m" in shown and '"x-thin"' in shown and "+0.400" in shown


def test_the_suggested_sweep_has_the_recorded_data_set_and_the_detector_of_this_one() -> None:
    default = {"pointpillars"}
    assert input_words({"waymo"}, default) == " scenes=waymo scenes.root=PATH"
    for several in ({"waymo", "kitti"}, {"street-hdl64"}, {"street-hdl64", "kitti"}, set()):
        assert input_words(several, default) == ""
    own = " scenes=openpcdet scenes.root=PATH detector=own detector.module=FILE.py"
    assert input_words({"openpcdet"}, {"own"}) == own
    assert input_words({"street-hdl64"}, {"sst"}) == " detector=sst"
    assert input_words({"street-hdl64"}, {"pointpillars", "sst"}) == ""
    sets = {"cars": "vehicle=set vehicle.folder=PATH", "wide": "vehicle=wide"}
    for folder, words in sets.items():
        found = input_words({"street-hdl64"}, default, [AssetsSpec({}, {"kind": "set", "folder": folder})])
        assert found == f" {words} vehicle.name=NAME"
    cars = AssetsSpec({}, {"kind": "set", "folder": "cars"})
    assert input_words({"street-hdl64"}, default, [AssetsSpec({})]) == ""
    assert input_words({"street-hdl64"}, default, [AssetsSpec({}), cars]) == ""
    weights = [AssetsSpec({}, detectors=dict.fromkeys(get_args(DetectorName), "new.pt"))]
    assert input_words({"street-hdl64"}, default, weights) == " detector.weights=FILE"
    named = " detector=own detector.module=FILE.py detector.weights=FILE"
    assert input_words({"street-hdl64"}, {"own"}, weights) == named
    for name in get_args(DetectorName):
        assert input_words({"street-hdl64"}, {name}, weights).count("weights=") == (name != "onnx")
    for name in get_args(DetectorName):
        needs = {"own": "module", "onnx": "file", "openpcdet": "config", "mmdet3d": "config"}.get(name, "")
        assert f"detector.{needs}" in input_words({"street-hdl64"}, {name}) or not needs
