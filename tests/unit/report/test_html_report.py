"""The report: its numbers are those of the tables, its measures those of the mesh, and it needs nothing but itself."""

from __future__ import annotations

import dataclasses
import itertools
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import trimesh
import valid_sweeps

from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.evaluation.recall_curve import area_under, recall_curve
from shift3d.report.html.areas import areas, in_short
from shift3d.report.html.bev import bev, pooled_cells
from shift3d.report.html.coverage import coverage_section
from shift3d.report.html.curves import curves, thresholds
from shift3d.report.html.differences import differences
from shift3d.report.html.document import Markup, Section, document, table
from shift3d.report.html.figure import COLOURS, figure_html
from shift3d.report.html.hardest import hardest, simplified
from shift3d.report.html.measures import change_lines, in_words, measure_mesh
from shift3d.report.html.paper import paper_table
from shift3d.report.html.stability import stability
from shift3d.report.html.statistics import holm, mean_area, paired, recall_band
from shift3d.report.html.sweep import Sweep, Variant, read_sweep, variants
from shift3d.report.html.write import write_report
from shift3d.store.log import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """What a page is made of, and whether every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.headings: list[str] = []
        self.feed(text)
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, tag

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "sweep"
    valid_sweeps.write_sweep(folder)
    write_final(folder, read_plan(folder), read_log(folder))
    return folder


@pytest.fixture(scope="module")
def text(finished: Path) -> str:
    return write_report(finished).read_text()


def test_a_trial_says_that_its_numbers_mean_nothing(text: str) -> None:
    assert "A trial: these AUCs mean nothing, with a search of 5 steps" in text


def variant(scores: dict[tuple[str, str], list[float]], mode: str = "shape") -> Variant:
    """Scores by (method, vehicle), one a scene, as the sections take them."""
    rows = [
        {"task_id": f"{vehicle}-{scene}", "place": f"street/{scene}", "method": method, "vehicle": vehicle}
        | {"score": score, "lambda": 1.0 if mode == "shape" else np.nan}
        for (method, vehicle), values in scores.items()
        for scene, score in enumerate(values)
    ]
    named = {"mode": mode, "detector": "pointpillars", "scored_by": "pointpillars", "effects": "none"}
    label, key = f"adversarial {mode}", f"{mode}-0"
    return Variant(**named, alpha=0.01, accuracy="standard", label=label, key=key, rows=pd.DataFrame(rows))


def two_vehicles() -> Variant:
    rng = np.random.default_rng(1)
    base = {("baseline", name): list(0.7 + 0.2 * rng.random(12)) for name in ("coupe", "suv")}
    hard = {("adversarial", name): [0.5 * v for v in base["baseline", name]] for name in ("coupe", "suv")}
    return variant(base | hard)


def test_the_page_is_one_file_that_asks_for_nothing(text: str) -> None:
    page = Page(text)
    assert len(text.encode()) < 10e6
    for tag, attributes in page.tags:
        for name in ("src", "href", "action", "data", "poster"):
            assert not re.match(r"(https?:)?//", attributes.get(name) or ""), (tag, attributes)
    assert "default-src 'none'" in (page.all("meta")[1]["content"] or "")
    assert text.count("plotly.js v") == 1
    # Everything that is not the library: neither paths of a machine nor addresses.
    own = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "http" not in own.replace("http-equiv", "") and "/tmp" not in own


def test_the_page_can_be_read_without_seeing_it(text: str) -> None:
    page = Page(text)
    assert page.headings.count("h1") == 1 and page.headings[0] == "h1"
    levels = [int(name[1]) for name in page.headings]
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert page.all("html")[0]["lang"] == "en"
    assert [len(page.all(name)) for name in ("header", "main", "nav", "footer")] == [1, 1, 1, 1]
    tables = page.all("table")
    assert len(tables) > 5 and len(page.all("caption")) == len(tables)
    assert text.count("<table><caption>") == len(tables)
    assert all(head.get("scope") in ("col", "row") for head in page.all("th"))
    plots = [attributes for attributes in page.all("div") if attributes.get("class") == "plot"]
    assert plots and all(plot["role"] == "img" and plot["aria-label"] for plot in plots)
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    targets = [link["href"] for link in page.all("a")]
    assert targets and all((target or "")[1:] in ids for target in targets)
    assert "prefers-color-scheme: dark" in text and "max-width: 480px" in text


def test_same_sweep_same_bytes(finished: Path, text: str) -> None:
    assert write_report(finished).read_text() == text


def test_what_is_not_there_is_said(text: str) -> None:
    assert "Not verified" in text and "Not measured by this sweep" in text
    # The sweep by hand names weights that nobody has: the page is written, and says why no case is drawn.
    assert "cannot be drawn" in text


def test_a_folder_that_is_no_finished_sweep_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"no spec\.yaml.*Check the path") as caught:
        write_report(tmp_path)
    assert str(tmp_path) in str(caught.value)
    begun = tmp_path / "begun"
    valid_sweeps.write_sweep(begun)
    assert main(["report", str(begun)]) == 2
    told = capsys.readouterr().err
    assert f"{begun}: the sweep is not finished. Run its command again" in told
    assert not (begun / "report.html").exists()
    write_final(begun, read_plan(begun), read_log(begun))
    (begun / "env.json").write_text("[1")
    with pytest.raises(InputError, match=r"env\.json.*Restore it"):
        write_report(begun)


def test_areas_are_the_mean_scores_with_the_papers_beside_them() -> None:
    scores = {("baseline", "coupe"): [0.9, 0.7], ("baseline", "suv"): [0.6, 0.8]}
    scores |= {("adversarial", "coupe"): [0.2, 0.4], ("adversarial", "suv"): [0.5, 0.4]}
    shown = "\n".join(areas([variant(scores)]).body)
    for auc in ("0.800", "0.700", "0.750", "0.300", "0.450", "0.375"):
        assert f"<td>{auc}<small>" in shown
    assert "<small>2 scenes</small>" in shown and "<td>0.50<small>[" in shown and "tab:auc_z" in shown
    for paper in ("0.755", "0.466", "0.469", "0.716", "0.728"):
        assert f"<td>{paper}</td>" in shown
    said = in_short([variant(scores)]).body[0]
    assert "0.750 → 0.375, 0.50 [" in said and f"paper: {(0.466 + 0.469) / (0.755 + 0.755):.2f}" in said


def test_vehicles_that_the_paper_has_not_are_said_so() -> None:
    shown = "\n".join(areas([variant({("baseline", "van"): [0.9, 0.7], ("adversarial", "van"): [0.2, 0.4]})]).body)
    assert "tab:auc_z" not in shown and "The paper has no table of these vehicles" in shown


@pytest.mark.parametrize(
    ("which", "method", "name", "values"),
    [
        (("shape", "pointpillars", "pointpillars"), "baseline", "tab:auc_z", (0.755, 0.756, 0.755, 0.681, 0.779)),
        (("shape", "pointpillars", "pointpillars"), "random", "tab:auc_z", (0.716, 0.721, 0.728, 0.625, 0.746)),
        (("shape", "pointpillars", "pointpillars"), "adversarial_noise", "tab:auc_z",
         (0.469, 0.451, 0.473, 0.392, 0.519)),
        (("shape", "pointpillars", "pointpillars"), "adversarial", "tab:auc_z", (0.466, 0.448, 0.469, 0.390, 0.514)),
        (("pose", "pointpillars", "pointpillars"), "baseline", "tab:auc_theta", (0.755, 0.756, 0.755, 0.681, 0.779)),
        (("pose", "pointpillars", "pointpillars"), "random", "tab:auc_theta", (0.683, 0.705, 0.719, 0.611, 0.713)),
        (("pose", "pointpillars", "pointpillars"), "adversarial", "tab:auc_theta",
         (0.580, 0.574, 0.571, 0.489, 0.648)),
        (("shape", "sst", "sst"), "baseline", "tab:sst_auc_z", (0.812, 0.817, 0.743, 0.726, 0.830)),
        (("shape", "sst", "sst"), "adversarial", "tab:sst_auc_z", (0.533, 0.524, 0.471, 0.448, 0.585)),
        (("shape", "sst", "pointpillars"), "adversarial", "tab:sst_auc_z", (0.559, 0.538, 0.581, 0.461, 0.623)),
        (("pose", "sst", "sst"), "adversarial", "tab:sst_auc_theta", (0.681, 0.678, 0.518, 0.544, 0.740)),
        (("pose", "sst", "pointpillars"), "adversarial", "tab:sst_auc_theta", (0.691, 0.695, 0.659, 0.601, 0.739)),
    ],
)  # fmt: skip
def test_the_papers_numbers_are_the_papers(
    which: tuple[str, str, str], method: str, name: str, values: tuple[float, ...]
) -> None:
    found = paper_table(*which)
    assert found is not None and found.name == name
    assert tuple(found.auc[method].values()) == values
    assert tuple(found.auc[method]) == ("coupe", "sports_car", "suv", "convertible", "beach_wagon")


def test_a_vehicle_with_more_scores_weighs_no_more_in_the_mean() -> None:
    rows = pd.DataFrame(
        {"score": [0.9, 0.9, 0.9, 0.1], "vehicle": ["suv"] * 3 + ["coupe"], "place": ["a", "b", "c", "a"]}
    )
    found = mean_area(rows)
    assert found is not None and found.interval.mean == pytest.approx(0.5) and found.scenes == 3


def test_bands_hold_their_curve_and_its_area_is_the_mean_score() -> None:
    rng = np.random.default_rng(0)
    scores, places = rng.beta(2, 1, size=300), [f"scene-{i // 6}" for i in range(300)]
    band = recall_band(scores, places, thresholds())
    assert band.low is not None and band.high is not None
    assert (band.low <= band.recall).all() and (band.recall <= band.high).all()
    assert (band.high - band.low)[50:150].min() > 0.02
    assert band.recall == pytest.approx([(scores > t).mean() for t in thresholds()], abs=1e-12)
    assert area_under(recall_curve(scores)) == pytest.approx(scores.mean(), abs=1e-9)
    assert recall_band(scores[:6], places[:6], thresholds()).low is None
    again = recall_band(scores, places, thresholds())
    assert again.low is not None and (again.low == band.low).all()


def test_a_band_covers_the_truth_about_as_often_as_it_says() -> None:
    rng, at, held = np.random.default_rng(2), np.array([0.5]), 0
    for _ in range(200):
        band = recall_band(rng.random(80), [str(i) for i in range(80)], at)
        assert band.low is not None and band.high is not None
        held += bool(band.low[0] <= 0.5 <= band.high[0])
    assert 0.88 <= held / 200 <= 0.99


def test_differences_are_paired_by_task_and_tested_by_scene() -> None:
    found = two_vehicles()
    result = paired(found.rows, "adversarial", "baseline")
    assert result is not None and (result.scenes, result.tasks) == (12, 24)
    base = found.rows[found.rows["method"] == "baseline"]["score"]
    assert result.interval.mean == pytest.approx(-0.5 * base.mean())
    assert result.p_value == pytest.approx(2 / 2**12)  # every scene falls: the least that 12 scenes can give
    assert paired(found.rows, "random", "baseline") is None
    shown = "\n".join(differences([found]).body)
    assert f"{-0.5 * base.mean():+.3f}" in shown and "4.9e-04" in shown and "<td>0.001</td>" in shown


def test_holm_steps_down() -> None:
    assert holm([0.01, 0.04, None, 0.03]) == [pytest.approx(0.03), pytest.approx(0.06), None, pytest.approx(0.06)]
    assert holm([]) == [] and holm([0.9, 0.8]) == [1.0, 1.0]


def test_curves_have_a_panel_a_vehicle_and_one_of_all_with_bands() -> None:
    shown = "\n".join(curves([two_vehicles()]).body)
    assert shown.count('class="plot"') == 3 and shown.count("tonexty") == 6
    assert "all vehicles: 12 scenes, 24 tasks" in shown and "no band" not in shown
    one = curves([variant({("baseline", "suv"): [0.9], ("adversarial", "suv"): [0.1]})])
    assert "no band" in "\n".join(one.body)


def test_cells_pool_vehicles_by_their_scores(finished: Path) -> None:
    sweep = read_sweep(finished)
    (found,) = variants(sweep)
    cells = sweep.bev[sweep.bev["method"] == "adversarial"]
    more = cells.assign(scores=3, mean_reduction=-0.2)
    grid = dataclasses.replace(sweep, bev=pd.concat([cells, more]))
    pooled = pooled_cells(grid.bev, found)
    own = cells.iloc[0]
    expected = (own["scores"] * own["mean_reduction"] - 0.6) / (own["scores"] + 3)
    assert pooled["mean_reduction"].iloc[0] == pytest.approx(expected)
    assert "1 cells of 10 m" in "\n".join(bev(grid, [found]).body)
    empty = dataclasses.replace(sweep, bev=sweep.bev.iloc[:0])
    assert "there is no grid" in "\n".join(bev(empty, [found]).body)


def test_the_hardest_are_of_other_vehicles_and_scenes_first() -> None:
    falls = {("a", "suv", "1"): 0.8, ("b", "suv", "1"): 0.7, ("c", "coupe", "1"): 0.3, ("d", "coupe", "2"): 0.2,
             ("e", "van", "3"): -0.1}  # fmt: skip
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
    # What is no car any more comes last, and only where there are not enough others.
    assert [case.task_id for case in hardest(frame, 2, {"a", "d"})] == ["b", "c"]
    assert [case.task_id for case in hardest(frame, 3, {"a", "d"})] == ["b", "c", "d"]


def test_a_box_is_measured_in_centimetres() -> None:
    box = trimesh.creation.box((4.2, 1.8, 1.5))
    found = measure_mesh(box)
    assert (found.length_cm, found.width_cm, found.height_cm) == pytest.approx((420.0, 180.0, 150.0))
    assert found.volume_m3 == pytest.approx(4.2 * 1.8 * 1.5) and found.pieces == 1
    assert found.clearance_cm == pytest.approx(0.0, abs=1e-6)
    assert found.nose_cm == pytest.approx(150.0) and found.windshield_deg == pytest.approx(90.0)
    assert "not measured" not in str(change_lines(found, found))
    assert in_words(found, found).startswith("No measure changes")


def profile(lift_m: float, hood_m: float, windshield_deg: float) -> trimesh.Trimesh:
    """A car of 4 m x 1.8 m x 1.5 m drawn from the side: a hood of 1 m, a windshield, a roof; a bridge on two feet."""
    roof_m = 1.0 - (1.5 - hood_m) / np.tan(np.radians(windshield_deg))
    ends = [(-2.0, -1.2), (-1.2, roof_m), (roof_m, 1.0), (1.0, 1.2), (1.2, 2.0)]
    parts = []
    for rear, front in ends:
        low = 0.0 if abs(rear + front) > 3.0 else lift_m
        tops = np.interp((rear, front), (roof_m, 1.0), (1.5, hood_m))
        side = [(rear, low), (front, low), (rear, tops[0]), (front, tops[1])]
        parts.append(trimesh.convex.convex_hull([(x, y, z) for x, z in side for y in (-0.9, 0.9)]))
    return trimesh.util.concatenate(parts)


@pytest.mark.parametrize("hood_m", [0.8, 0.95, 1.05])
def test_windshield_nose_and_clearance_are_found_and_said(hood_m: float) -> None:
    before, after = measure_mesh(profile(0.2, hood_m, 30.0)), measure_mesh(profile(0.26, hood_m, 50.0))
    assert before.windshield_deg == pytest.approx(30.0, abs=1.5)
    assert after.windshield_deg == pytest.approx(50.0, abs=2.5)
    assert before.nose_cm == pytest.approx(100 * hood_m) and before.clearance_cm == pytest.approx(20.0)
    said = in_words(before, after)
    assert "underside 6 cm farther from the ground" in said and "windshield 2" in said and "steeper" in said


def test_a_large_mesh_is_made_small_enough_for_a_page() -> None:
    vertices, faces = simplified(trimesh.creation.icosphere(subdivisions=6))
    assert len(faces) <= 5000 and np.abs(np.linalg.norm(vertices, axis=1) - 1.0).max() < 0.02
    assert faces.max() < len(vertices)


def test_plain_text_stays_text() -> None:
    shown = table("a <b>", ["x", "y"], [["<i>", Markup("<small>1</small>")]])
    assert "a &lt;b&gt;" in shown and "&lt;i&gt;" in shown and "<small>1</small>" in shown
    page = document("t", "l", [Section("k", "<s>", [])], "")
    assert "&lt;s&gt;" in page


def test_a_name_cannot_end_the_figures_script() -> None:
    traces = [{"type": "scatter", "x": [0], "y": [1], "name": "</script><b>"}]
    shown = figure_html("k", traces, {}, 'a "label"', "c")
    Page(shown)
    assert "</script><b>" not in shown and "&quot;label&quot;" in shown


def test_colours_show_on_light_and_dark() -> None:
    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts]
        return float(np.dot(linear, (0.2126, 0.7152, 0.0722)))

    for colour in COLOURS.values():
        for ground in ("#f4f5f7", "#1e2127"):
            dark, light = sorted((luminance(colour), luminance(ground)))
            assert (light + 0.05) / (dark + 0.05) >= 3.0, (colour, ground)


def test_variants_name_what_differs_and_shape_comes_first(finished: Path) -> None:
    sweep = read_sweep(finished)
    (alone,) = variants(sweep)
    assert (alone.label, alone.vehicles) == ("adversarial shape", ["suv"])
    assert alone.methods == ["baseline", "random", "adversarial"]
    assert isinstance(sweep, Sweep) and sweep.scored["place"].nunique() == 2


def test_what_is_unstable_is_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    rows = [
        {"task_id": f"task{index}", "vehicle": "suv", "scene": "north", "mode": "shape", "lambda": 1.0}
        | {"scored_by": "pointpillars", "method": "adversarial", "score": 0.3, "score_again": 0.3, "robust": index > 1}
        | {"score_reference": 0.3 if index else 0.55, "stable": index > 0, "cause": "of <300> hits 9 missed"}
        for index in range(4)
    ]
    shown = "\n".join(stability(dataclasses.replace(sweep, verification=pd.DataFrame(rows))).body)
    assert "<td>4</td><td>1</td><td>2.5e-01</td><td>100%</td><td>50%</td>" in shown
    assert shown.count("of &lt;300&gt; hits 9 missed") == 1 and "task0" in shown


def test_failures_are_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost, kept = (task.spec.task_id for task in sweep.plan.tasks)
    scores = sweep.scores[sweep.scores["task_id"] == kept]
    failed = {"outcome": "failed", "quarantined": True, "error": "ValueError: <no>"}
    attempts = sweep.attempts.assign(outcome="done", quarantined=False, error=None).astype({"error": object})
    attempts.loc[attempts["task_id"] == lost, list(failed)] = list(failed.values())
    found = dataclasses.replace(sweep, scores=scores, attempts=attempts.drop_duplicates("task_id"))
    shown = "\n".join(coverage_section(found).body)
    assert '<th scope="row">quarantined</th><td>1</td>' in shown and '<th scope="row">scored</th><td>1</td>' in shown
    assert f"Quarantined: {lost}: ValueError: &lt;no&gt;" in shown and "Nothing failed" not in shown
