"""The report: its numbers are those of the tables, its measures those of the mesh, and it is self-contained."""

from __future__ import annotations

import itertools
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import valid_sweeps
from analysed import blocks_html

from shift3d.analysis.figures.picture import COLOURS
from shift3d.analysis.html.blocks import Section
from shift3d.analysis.html.document import document
from shift3d.analysis.html.figure import DASHES, plot
from shift3d.analysis.html.report import write_report
from shift3d.analysis.tables.table import Table
from shift3d.cli.main import main
from shift3d.errors import InputError
from shift3d.methods import METHODS
from shift3d.store.log_entries import read_log
from shift3d.sweep.planning.folder import read_plan
from shift3d.sweep.results.final import write_final

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Elements of a page, and if every tag is closed."""

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
    # Everything but the library: neither paths of a machine nor addresses.
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
    # The handmade sweep names weights that do not exist: the page is written, and states why no case is drawn.
    assert "cannot be drawn" in text


def test_a_folder_that_is_no_finished_sweep_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match=r"it does not exist, or is empty.*Check the path") as caught:
        write_report(tmp_path)
    assert str(tmp_path) in str(caught.value)
    begun = tmp_path / "begun"
    valid_sweeps.write_sweep(begun)
    assert main(["report", str(begun)]) == 2
    printed = capsys.readouterr().err
    status = f"shift3d sweep status {begun} says whether it still runs; if not, run its command again: it resumes"
    assert f"{begun}: the sweep is not finished. {status}" in printed, "a second driver would stop a running one"
    assert not (begun / "report.html").exists()
    write_final(begun, read_plan(begun), read_log(begun))
    (begun / "env.json").write_text("[1")
    with pytest.raises(InputError, match=r"env\.json.*Restore it"):
        write_report(begun)


def test_what_people_look_for_comes_first(text: str) -> None:
    titles = re.findall(r"<h2[^>]*>([^<]*)</h2>", text)
    assert titles[:4] == ["In short", "The hard cases", "Gallery", "Area under the curve"]
    # Long statistics are folded.
    section = text[text.index('<h2 id="differences"') :]
    assert section.index("<details>") < section.index("<table>")


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
