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
import valid_sweeps
from analysed import two_vehicles, variant

from shift3d.analysis.cases.chosen import hardest, random_positions
from shift3d.analysis.cases.rendered import Loaded
from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Section
from shift3d.analysis.html.document import blocks_html, document
from shift3d.analysis.html.figure import DASHES, plot
from shift3d.analysis.html.report import write_report
from shift3d.analysis.html.sections.auc import auc_blocks, differences
from shift3d.analysis.html.sections.bev import bev, pooled_cells
from shift3d.analysis.html.sections.curves import curves
from shift3d.analysis.html.sections.gallery import gallery
from shift3d.analysis.html.sections.in_short import headline
from shift3d.analysis.html.sections.overview import coverage
from shift3d.analysis.html.sections.stability import stability
from shift3d.analysis.results import Sweep, read_sweep
from shift3d.analysis.statistics.paired import paired
from shift3d.analysis.tables.table import Table
from shift3d.analysis.variants import variants
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.methods import METHODS
from shift3d.store.log_entries import read_log
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
    printed = capsys.readouterr().err
    assert f"{begun}: the sweep is not finished. Run its command again" in printed
    assert not (begun / "report.html").exists()
    write_final(begun, read_plan(begun), read_log(begun))
    (begun / "env.json").write_text("[1")
    with pytest.raises(InputError, match=r"env\.json.*Restore it"):
        write_report(begun)


def test_areas_are_the_mean_scores_with_the_papers_beside_them() -> None:
    scores = {("baseline", "coupe"): [0.9, 0.7], ("baseline", "suv"): [0.6, 0.8]}
    scores |= {("adversarial", "coupe"): [0.2, 0.4], ("adversarial", "suv"): [0.5, 0.4]}
    shown = blocks_html(auc_blocks(variant(scores)))
    for auc in ("0.800", "0.700", "0.750", "0.300", "0.450", "0.375"):
        assert f"<td>{auc}<small>" in shown
    assert "<small>2 scenes</small>" in shown and "<td>0.50<small>[" in shown and "tab:auc_z" in shown
    for paper in ("0.755", "0.466", "0.469", "0.716", "0.728"):
        assert f"<td>{paper}</td>" in shown
    short = headline(variant(scores))
    assert (
        "from 0.750 to 0.375, a ratio of 0.50 [" in short and f"paper: {(0.466 + 0.469) / (0.755 + 0.755):.2f}" in short
    )
    assert short.count(".") - len(re.findall(r"\d\.\d", short)) == 1, "one sentence"


def test_the_unnatural_shapes_stand_in_the_sentence_of_the_ratio() -> None:
    scores = {("baseline", "suv"): [0.8, 0.8, 0.8], ("adversarial", "suv"): [0.6, 0.2, 0.1]}
    some = headline(variant(scores, natural={"suv-0": True, "suv-1": False, "suv-2": False}))
    assert "a ratio of 0.37" in some and "but 2 of 3 shapes are unnatural (ratio over the 1 natural: 0.75)." in some
    every = {f"suv-{scene}": True for scene in range(3)}
    assert "all 3 shapes are natural" in headline(variant(scores, natural=every))
    assert "was not measured" in headline(variant(scores, natural={}))
    assert "natural" not in headline(variant(scores, mode="pose"))


def test_vehicles_that_the_paper_has_not_are_named() -> None:
    shown = blocks_html(auc_blocks(variant({("baseline", "van"): [0.9, 0.7], ("adversarial", "van"): [0.2, 0.4]})))
    assert "tab:auc_z" not in shown and "The paper has no table of these vehicles" in shown


def test_what_people_look_for_comes_first(text: str) -> None:
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", text)
    assert titles[:4] == ["In short", "The hard cases", "Random solutions", "Area under the curve"]
    # Long statistics are folded.
    section = text[text.index('<h2 id="differences"') :]
    assert section.index("<details>") < section.index("<table>")


def test_the_gallery_draws_over_all_tasks_whatever_became_of_them(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost, _ = (task.spec.task_id for task in sweep.plan.tasks)
    scores = sweep.scores.copy()
    own = scores["task_id"] == lost
    scores.loc[own, "score"], scores.loc[own, "status"] = np.nan, "no_placement"
    section = gallery(dataclasses.replace(sweep, scores=scores), Loaded(sweep.plan))
    shown = blocks_html(section.blocks)
    assert shown.count("<figure>") == 2 and "no placement" in shown
    assert "All 2 tasks" in shown and "0.90 → 0.30" in shown


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
    shown = blocks_html(differences([found]).blocks)
    assert f"{-0.5 * base.mean():+.3f}" in shown and "4.9e-04" in shown and "<td>0.001</td>" in shown


def test_curves_have_a_panel_a_vehicle_and_one_of_all_with_bands() -> None:
    shown = blocks_html(curves([two_vehicles()]).blocks)
    assert shown.count('class="plot"') == 3 and shown.count("tonexty") == 6
    assert "all vehicles: 12 scenes, 24 tasks" in shown and "no band" not in shown
    one = curves([variant({("baseline", "suv"): [0.9], ("adversarial", "suv"): [0.1]})])
    assert "no band" in blocks_html(one.blocks)


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
    assert "1 cells of 10 m" in blocks_html(bev(grid, [found]).blocks)
    empty = dataclasses.replace(sweep, bev=sweep.bev.iloc[:0])
    assert "there is no grid" in blocks_html(bev(empty, [found]).blocks)


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


def test_plain_text_stays_text() -> None:
    shown = blocks_html([Table("a <b>", ["x", "y"], [["<i>", ("1 & 2", "<small>")]])])
    assert "a &lt;b&gt;" in shown and "&lt;i&gt;" in shown and "1 &amp; 2<small>&lt;small&gt;</small>" in shown
    page = document("t", [Section("k", "<s>", [])], "l")
    assert "&lt;s&gt;" in page and "<script" not in page


def test_a_name_cannot_end_the_figures_script() -> None:
    traces = [{"type": "scatter", "x": [0], "y": [1], "name": "</script><b>"}]
    shown = blocks_html([plot("k", traces, {}, 'a "label"', "c")])
    Page(shown)
    assert "</script><b>" not in shown and "&#34;label&#34;" in shown


def test_every_method_has_a_colour_and_a_dash() -> None:
    assert COLOURS.keys() == DASHES.keys() == METHODS.keys()


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
    (alone,) = variants(sweep.auc, sweep.scored)
    assert (alone.label, alone.vehicles) == ("adversarial shape", ["suv"])
    assert alone.methods == ["baseline", "random", "adversarial"]
    assert isinstance(sweep, Sweep) and sweep.scored["place"].nunique() == 2


def test_what_is_unstable_is_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    rows = [
        {"task_id": f"task{index}", "vehicle": "suv", "scene": "north", "mode": "shape", "lambda": 1.0}
        | {"scored_by": "pointpillars", "method": "adversarial", "replicate": 0, "score": 0.3, "score_again": 0.3}
        | {"robust": index > 1, "margin": 0.5, "least_margin_noise": 0.4, "least_margin_nearby": 0.4}
        | {"score_reference": 0.3 if index else 0.55, "stable": index > 0, "cause": "of <300> hits 9 missed"}
        for index in range(4)
    ]
    shown = blocks_html(stability(dataclasses.replace(sweep, verification=pd.DataFrame(rows))).blocks)
    assert "<td>4</td><td>1</td><td>75.0%</td><td>2.5e-01</td><td>100%</td><td>50%</td>" in shown
    assert shown.count("of &lt;300&gt; hits 9 missed") == 1 and "task0" in shown


def test_failures_are_counted_and_named(finished: Path) -> None:
    sweep = read_sweep(finished)
    lost, kept = (task.spec.task_id for task in sweep.plan.tasks)
    scores = sweep.scores[sweep.scores["task_id"] == kept]
    failed = {"outcome": "failed", "quarantined": True, "error": "ValueError: <no>"}
    attempts = sweep.attempts.assign(outcome="done", quarantined=False, error=None).astype({"error": object})
    attempts.loc[attempts["task_id"] == lost, list(failed)] = list(failed.values())
    found = dataclasses.replace(sweep, scores=scores, attempts=attempts.drop_duplicates("task_id"))
    shown = blocks_html(coverage(found).blocks)
    assert "1 of 2 tasks scored" in shown and "1 quarantined" in shown
    assert f"{lost}  ValueError: &lt;no&gt;" in shown and "Nothing failed" not in shown
